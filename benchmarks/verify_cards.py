"""Ready cards against the authors' own code: the same depth of the same images, to the digit.

Figure of merit: mean absolute difference of depth by standard deviation of theirs, largest of eight
images of other sizes, aspects and bit depths; at most 1e-3 at the network's size. The network has
random weights: its preprocessing, graph and postprocessing are those of the trained one. It is
built and run by the authors' package in an environment of its own, which this script makes.
Run: ``python benchmarks/verify_cards.py [CARD ...] [--environments DIR] [--write]``
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from tools import parse_options

from depthcli.core.camera import Intrinsics
from depthcli.core.options import DepthMask, Upsampling, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.inference.transforms import coarse_depth, metric_scale, prepare, prompt_input
from depthcli.io.images.read import read_image
from depthcli.known.points import KnownDepth
from depthcli.models.card import ModelCard
from depthcli.models.catalog import FOLDER, Model, ready_fields

HERE = Path(__file__).parent
KEPT = HERE.parent / "tests" / "reference" / "cards"
MOST = 1e-3
OFF = np.float32(0.01 / 0.225)  # of the input, by a mean that is wrong by 0.01
TORCH = ("torch==2.13.0", "onnx==1.23.2", "opencv-python-headless==5.0.0.93", "scipy")
# Pillow 13 resizes some portrait images along the columns first, which changes rounding:
# github.com/python-pillow/Pillow/pull/9549
HUB = ("transformers==5.24.0", "pillow<13", *TORCH)
VISION = ("torchvision==0.28.0", "timm==1.0.31")


class Package(NamedTuple):
    """The authors' code."""

    module: str  #: file in ``authors/`` that builds the network and runs it
    alone: tuple[str, ...] = ()  #: packages to install without those that they need
    environment: str = "transformers"  #: name of the folder with its packages
    needs: tuple[str, ...] = HUB  #: packages to install


ANYTHING_V2 = Package("of_depth_anything_v2", (*VISION, "jkp-depth-anything-v2==0.1.1"))
ANYTHING_3_NEEDS = ("addict", "omegaconf", "antlr4-python3-runtime==4.9.3", "einops", "imageio")
MOGE_NEEDS = ("dlr-utils3d==1.3", "dlr-pipeline==1.0.0", "trimesh", "click")
YOLO_NEEDS = ("polars", "psutil", "requests", "pyyaml", "matplotlib")
PACKAGES = {
    "transformers 5.24.0": Package("of_transformers", VISION),
    "jkp-depth-anything-v2 0.1.1": ANYTHING_V2,
    "jkp-depth-anything-v2 0.1.1 and transformers 5.24.0": ANYTHING_V2,
    "depth-anything-3 0.1.1": Package(
        "of_depth_anything_3", (*VISION, "depth-anything-3==0.1.1", *ANYTHING_3_NEEDS)
    ),
    "libreyolo 1.6.0": Package("of_zipdepth", (*VISION, "libreyolo==1.6.0")),
    "controlnet-aux 0.0.10 and transformers 5.24.0": Package(
        "of_midas", (*VISION, "controlnet-aux==0.0.10", "geffnet")
    ),
    "ultralytics 8.4.190": Package(
        "of_ultralytics",
        (*VISION, "ultralytics==8.4.190", "ultralytics-thop"),
        "ultralytics",
        (*HUB, *YOLO_NEEDS),
    ),
    "lightly-train 0.18.0": Package(
        "of_lightly", VISION[:1], "lightly", (*HUB, "lightly-train==0.18.0")
    ),
    "dlr-moge 2.0.0": Package("of_moge", (*VISION, "dlr-moge==2.0.0", *MOGE_NEEDS)),
}
"""By the name and version that cards state."""
SAME = "as {}, of the same code and processing"
"""Note of a card whose network differs from a compared one in width, layers or range alone."""


def main() -> None:
    """Compare the given cards, or all, and print a line for each."""
    packages = compared()
    options = parse_options(
        __doc__,
        rest=("cards", list(packages)),
        environments=Path(tempfile.gettempdir()) / "authors",
        write=False,
    )
    failed = False
    together: dict[str, list[str]] = {}
    for card in options.cards:
        together.setdefault(packages[card], []).append(card)
    for package, cards in together.items():
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            run_theirs(PACKAGES[package], cards, options.environments, folder)
            for card in cards:
                differences = compare(card, folder)
                failed |= not differences.worst <= MOST
                print(
                    f"{card:40} {package:28} network's size {differences.small:.1e}, full size "
                    f"{differences.full:.1e}; wrong by 0.01 {differences.control:.1e}",
                    flush=True,
                )
                if options.write and differences.worst <= MOST:
                    write(card, differences)
                    shutil.copy(folder / card / "kept.npz", KEPT / f"{card}.npz")
    sys.exit(failed)


def compared() -> dict[str, str]:
    """The package that each card states that is compared by itself."""
    packages = {}
    for path in sorted(FOLDER.glob("*.json")):
        verification = json.loads(path.read_text("utf-8")).get("verification", {})
        if "package" in verification and not verification.get("note", "").startswith("as "):
            packages[path.stem] = verification["package"]
    return packages


class Differences(NamedTuple):
    """Largest differences over the images."""

    small: float  #: at the network's size
    full: float  #: at the image's size; NaN where they do not enlarge
    control: float  #: least at the network's size with a wrong mean, which shows what is seen

    @property
    def worst(self) -> float:
        """The larger one of both sizes."""
        return max(self.small, 0 if np.isnan(self.full) else self.full)


def run_theirs(package: Package, cards: list[str], environments: Path, folder: Path) -> None:
    """Run the authors' code on the images."""
    write_images(folder)
    python = environment(package, environments)
    command = [python, HERE / "authors" / "run.py", package.module, folder, *cards]
    subprocess.run([*map(str, command)], check=True, env=os.environ | {"PYTHONPATH": ""})


def compare(name: str, folder: Path) -> Differences:
    """Run the card on the images, and compare."""
    fields = ready_fields(name)
    fields |= {"onnx": {"opset": 18, "ir": 10} | fields.get("onnx", {})}
    card = ModelCard.from_json(json.dumps(fields))
    parts = []
    for path in sorted((folder / "ours").glob("*.png")):
        frame = read_image(path)
        batch, _ = prepare(card.input, frame)
        file = folder / name / "{}x{}.onnx".format(*batch.shape[2:])
        if not file.exists():
            print(f"{name}: {file.stem} is no size of theirs for {path.name}", file=sys.stderr)
            return Differences(np.inf, np.inf, 0)
        model = Model(path=file, card=card, sha256="", size_bytes=file.stat().st_size)
        theirs = np.load(folder / name / f"{path.stem}.npz")
        parts.append(of_image(Session(model, provider="cpu"), frame, batch, theirs))
    small, full, control = zip(*parts, strict=True)
    return Differences(max(small), max(full), min(control))


def of_image(
    session: Session, frame: Frame, batch: np.ndarray, theirs: dict[str, np.ndarray]
) -> tuple[float, float, float]:
    """Differences of one image."""
    # "has" is their mask, "at" where their depth is that of the network alone
    has = next((theirs[name] for name in ("has", "at") if name in theirs), np.True_)
    raw = theirs["raw"].reshape(theirs["raw"].shape[-2:])
    card, points, prompts = session.model.card, None, None
    if "known" in theirs:
        points = known_points(theirs["known"], frame)
        prompts = [prompt_input(card, points, frame, prepare(card.input, frame)[1])]
    ours, wrong = (session.run(image, prompts)[0] for image in (batch, batch + OFF))
    if ours.ndim > raw.ndim:  # points, of which z is compared
        ours, wrong = ours[..., 2], wrong[..., 2]
    small, control = difference(ours, raw), difference(wrong, raw)
    if "ground" in theirs:  # which has a depth, at the network's size
        mask = card.output.mask
        ground = session.outputs(batch).mask[0] < mask.threshold
        small = max(small, float((ground != theirs["ground"]).mean()))
    if "metres" in theirs:
        _, layout = prepare(card.input, frame)
        camera = Intrinsics(float(theirs["focal_px"]))
        scaled = coarse_depth(card.output, ours, layout) * metric_scale(card, frame, layout, camera)
        return small, difference(scaled, theirs["metres"]), control
    if "full" not in theirs:
        return small, np.nan, control
    mask = DepthMask.MODEL if "has" in theirs else DepthMask.NONE
    pipeline = Pipeline(session, UpsamplingOptions(Upsampling.MODEL, mask=mask))
    focal_px = float(theirs["focal_px"]) if "focal_px" in theirs else None
    depth_m = pipeline.predict(frame, Intrinsics(focal_px), points).depth.values
    both = has & np.isfinite(depth_m)
    full = difference(np.where(both, depth_m, np.nan), np.where(both, theirs["full"], np.nan))
    if "has" in theirs:
        print(f"of their mask, {np.mean(np.isfinite(depth_m) != has):.0e} differ", file=sys.stderr)
    return small, full, control


def known_points(depth_m: np.ndarray, frame: Frame) -> KnownDepth:
    """Points at the centres of the pixels of a map of the whole image."""
    y, x = (axis.ravel() for axis in np.indices(depth_m.shape))
    rows, columns = depth_m.shape
    places = [(x + 0.5) * frame.width / columns - 0.5, (y + 0.5) * frame.height / rows - 0.5]
    return KnownDepth.of_table(np.stack([*places, depth_m.ravel()], axis=1))


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Mean absolute difference by their standard deviation, over pixels that have depth there."""
    if ours.shape != theirs.shape:
        return np.inf
    has = np.isfinite(theirs)
    if not np.isfinite(ours[has]).all():
        return np.inf
    return float(np.abs(ours[has] - theirs[has]).mean() / theirs[has].std())


def write_images(folder: Path) -> None:
    """Eight images: NAME.png in 8 bits for them, ours/NAME.png with its own bit depth."""
    sizes = [(640, 480), (480, 640), (1024, 576), (320, 240), (251, 377), (1200, 400), (500, 500)]
    random = np.random.default_rng(34)
    for i, (width, height) in enumerate([*sizes, (1600, 1200)]):
        coarse = random.random((6, 8, 3), np.float32)
        values = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        for _ in range(12):
            x, y, radius = random.integers(0, width), random.integers(0, height), width // 12
            colour = [float(part) for part in random.random(3)]
            cv2.circle(values, (int(x), int(y)), int(radius), colour, -1)
        values += random.normal(0, 0.03, (height, width, 1)).astype(np.float32)
        pixels = (values.clip(0, 1) * 255).astype(np.uint8)
        if i in {4, 6}:
            pixels = np.repeat(pixels[..., :1], 3, axis=2)
        own = pixels.astype(np.uint16) * 257 if i in {5, 6} else pixels
        cv2.imwrite(str(folder / f"{i}.png"), pixels)
        (folder / "ours").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / "ours" / f"{i}.png"), own[..., 0] if i in {4, 6} else own)


def environment(package: Package, environments: Path) -> Path:
    """The Python of an environment with the package; made if it is not there."""
    folder = environments / package.environment
    python = folder / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    done = folder / "installed.txt"
    packages = [*package.needs, *package.alone]
    if not done.exists() or not set(packages) <= set(done.read_text("utf-8").split("\n")):
        pip = [str(python), "-m", "pip", "install", "-q"]
        subprocess.run([*pip, *package.needs], check=True)
        if package.alone:
            subprocess.run([*pip, "--no-deps", *package.alone], check=True)
        with done.open("a", encoding="utf-8") as listed:
            listed.write("\n".join(["", *packages]))
    return python


def write(card: str, differences: Differences) -> None:
    """Write the result into the files of a card and of its other sizes."""
    same = SAME.format(card)
    for path in FOLDER.glob("*.json"):
        fields = json.loads(path.read_text("utf-8"))
        earlier = fields.get("verification", {})
        if path.stem == card or earlier.get("note") == same:
            fields["verification"] = earlier | {
                "date": f"{datetime.now(UTC):%Y-%m-%d}",
                "images": 8,
                "difference": float(f"{differences.small:.1e}"),
            }
            if not np.isnan(differences.full):
                fields["verification"]["full_size"] = float(f"{differences.full:.1e}")
            path.write_text(json.dumps(fields, indent=2, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main()
