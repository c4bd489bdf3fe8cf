"""Pictures for benchmarks: rooms of 640×480 pixels with the texture and the size of photographs."""

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
