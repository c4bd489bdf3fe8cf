"""Pictures and videos for benchmarks: rooms with the texture and the size of photographs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

ROOM = Path(__file__).parents[1] / "docs" / "room.jpg"
WIDTH, HEIGHT = 640, 480


def write_pictures(folder: Path, count: int) -> list[Path]:
    """Write different JPEG files of 60-100 KB: the room from other places, in other light."""
    room = cv2.imread(str(ROOM))
    random = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in range(count):
        path = folder / f"{number:05}.jpg"
        quality = (cv2.IMWRITE_JPEG_QUALITY, 90)
        cv2.imwrite(str(path), _view(room, random), quality)
        paths.append(path)
    return paths


def write_video(path: Path, count: int, width: int = WIDTH, height: int = HEIGHT) -> Path:
    """Write a video at 30000/1001, Motion JPEG: the room, under grain, passing by and back."""
    room = cv2.resize(cv2.imread(str(ROOM)), (width * 5 // 4, height * 5 // 4))
    random = np.random.default_rng(0)
    code = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 30000 / 1001, (width, height))
    grains = random.normal(0, 3, (8, height, width, 1))
    path_px = [*range(width // 4), *range(width // 4, 0, -1)]
    for number in range(count):
        left, top = path_px[number % len(path_px)], height // 8
        view = room[top : top + height, left : left + width] + grains[number % len(grains)]
        writer.write(np.clip(view, 0, 255).astype(np.uint8))
    writer.release()
    return path


def _view(room: cv2.typing.MatLike, random: np.random.Generator) -> cv2.typing.MatLike:
    scale = random.uniform(1.0, 1.4)
    angle_deg = random.uniform(-5, 5)
    turn = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), angle_deg, scale)
    turn[:, 2] += random.uniform(-40, 40, 2)
    view = cv2.warpAffine(room, turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    if random.random() < 0.5:
        view = cv2.flip(view, 1)
    grain = random.normal(0, random.uniform(2, 5), (HEIGHT, WIDTH, 1))
    return np.clip(view * random.uniform(0.6, 1.2) + grain, 0, 255).astype(np.uint8)
