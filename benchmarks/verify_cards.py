"""Ready cards against the authors' own code: the same depth of the same pictures, to the digit.

Figure of merit: mean absolute difference of depth by standard deviation of theirs, largest of eight
pictures of other sizes, aspects and bit depths; at most 1e-3 at the network's size. The network has
random weights: its preprocessing, graph and postprocessing are those of the trained one. It is
built and run by the authors' package in an environment of its own, which this script makes.
Run: ``python benchmarks/verify_cards.py [CARD ...] [--environments DIR] [--write]``
"""

from __future__ import annotations

import argparse
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

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Intrinsics
from depthcli.core.options import DepthMask, Upsampling, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.inference.camera import metric_scale
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.inference.transforms import coarse_depth, prepare, prompt_input
from depthcli.io.images.read import read_image
from depthcli.models.card import ModelCard
from depthcli.models.catalog import FOLDER, Model, ready_fields

HERE = Path(__file__).parent
KEPT = HERE.parent / "tests" / "reference" / "cards"
MOST = 1e-3
OFF = np.float32(0.01 / 0.225)  # of the input, by a mean that is wrong by 0.01
TORCH = ("torch==2.13.0", "onnx==1.23.2", "opencv-python-headless==5.0.0.93", "scipy")
# Pillow 13 resizes some portrait pictures along the columns first, which changes rounding:
# github.com/python-pillow/Pillow/pull/9549
HUB = ("transformers==5.24.0", "pillow<13", *TORCH)
VISION = ("torchvision==0.28.0", "timm==1.0.31")


class Package(NamedTuple):
    """The authors' code."""

    name: str  #: with its version
    module: str  #: file in ``authors/`` that builds the network and runs it
    environment: str  #: name of the folder with its packages
    needs: tuple[str, ...]  #: packages to install
    alone: tuple[str, ...] = ()  #: packages to install without those that they need


TRANSFORMERS = Package("transformers 5.24.0", "of_transformers", "transformers", HUB, VISION)
ANYTHING_V2 = Package(
    "jkp-depth-anything-v2 0.1.1",
    "of_depth_anything_v2",
    "transformers",
    HUB,
    (*VISION, "jkp-depth-anything-v2==0.1.1"),
)
ANYTHING_V2_METRIC = ANYTHING_V2._replace(name=f"{ANYTHING_V2.name} and {TRANSFORMERS.name}")
ANYTHING_3_NEEDS = ("addict", "omegaconf", "antlr4-python3-runtime==4.9.3", "einops", "imageio")
ANYTHING_3 = Package(
    "depth-anything-3 0.1.1",
    "of_depth_anything_3",
    "transformers",
    HUB,
    (*VISION, "depth-anything-3==0.1.1", *ANYTHING_3_NEEDS),
)
ZIPDEPTH = Package(
    "libreyolo 1.6.0", "of_zipdepth", "transformers", HUB, (*VISION, "libreyolo==1.6.0")
)
MIDAS = Package(
    "controlnet-aux 0.0.10 and transformers 5.24.0",
    "of_midas",
    "transformers",
    HUB,
    (*VISION, "controlnet-aux==0.0.10", "geffnet"),
)
YOLO = Package(
    "ultralytics 8.4.190",
    "of_ultralytics",
    "ultralytics",
    (*HUB, "polars", "psutil", "requests", "pyyaml", "matplotlib"),
    (*VISION, "ultralytics==8.4.190", "ultralytics-thop"),
)
LIGHTLY = Package(
    "lightly-train 0.18.0", "of_lightly", "lightly", (*HUB, "lightly-train==0.18.0", VISION[0])
)
MOGE = Package(
    "dlr-moge 2.0.0",
    "of_moge",
    "transformers",
    HUB,
    (*VISION, "dlr-moge==2.0.0", "dlr-utils3d==1.3", "dlr-pipeline==1.0.0", "trimesh", "click"),
)
SAME = {
    "depth-anything-v1-small": ("depth-anything-v1-base", "depth-anything-v1-large"),
    "promptda-small": ("promptda-large",),
    "distill-any-depth-small": ("distill-any-depth-base", "distill-any-depth-large"),
    "depth-anything-v2-small": ("depth-anything-v2-base", "depth-anything-v2-large"),
    **{
        f"depth-anything-v2-metric-{place}-small": tuple(
            f"depth-anything-v2-metric-{place}-{size}" for size in ("base", "large")
        )
        for place in ("indoor", "outdoor")
    },
    "depth-anything-3-small": ("depth-anything-3-base",),
    "glpn-nyu": ("glpn-kitti",),
}
"""Cards of networks that differ from a compared one in width, layers or range alone."""
NOTES = {
    "moge-2": "the authors' least squares to a tolerance of 1e-12, theirs being 1e-3",
    "zoedepth-nyu": "without the authors' border and mirrored pass",
    "promptda-small": "the largest is of a picture with fewer columns than the map of known depth, "
    "of the others 2.8e-6",
    "zipdepth": "a port that loads the authors' weights",
    **dict.fromkeys(
        ("midas-dpt-swin2-tiny-256", "midas-dpt-beit-base-384"),
        "the authors' processing, the network of transformers",
    ),
}
PACKAGES = {
    "depth-anything-v2-small": ANYTHING_V2,
    "depth-anything-v2-metric-indoor-small": ANYTHING_V2_METRIC,
    "depth-anything-v2-metric-outdoor-small": ANYTHING_V2_METRIC,
    "depth-anything-v1-small": TRANSFORMERS,
    "distill-any-depth-small": TRANSFORMERS,
    "promptda-small": TRANSFORMERS,
    "midas-dpt-large-384": TRANSFORMERS,
    **{f"depth-anything-3-{kind}": ANYTHING_3 for kind in ("small", "mono", "metric")},
    "zipdepth": ZIPDEPTH,
    "moge-2": MOGE,
    "yolo26-depth": YOLO,
    "lightly-dav3-metric-tiny": LIGHTLY,
    "lightly-dav3-relative-tiny": LIGHTLY,
    **dict.fromkeys(
        (
            "midas-small-torch",
            "midas-dpt-swin2-tiny-256",
            "midas-dpt-beit-base-384",
        ),
        MIDAS,
    ),
    **dict.fromkeys(("glpn-nyu", "zoedepth-nyu", "depth-pro"), TRANSFORMERS),
}


def main() -> None:
    """Compare the given cards, or all, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cards", nargs="*", default=list(PACKAGES))
    parser.add_argument(
        "--environments", type=Path, default=Path(tempfile.gettempdir()) / "authors"
    )
    parser.add_argument(
        "--write", action="store_true", help="write the result into the card, and what tests keep"
    )
    parser.add_argument("--theirs", type=Path, help="folder with their side of an earlier run")
    options = parser.parse_args()
    failed = False
    together: dict[Package, list[str]] = {}
    for card in options.cards:
        together.setdefault(PACKAGES[card], []).append(card)
    for package, cards in together.items():
        with tempfile.TemporaryDirectory() as temporary:
            folder = options.theirs or Path(temporary)
            if not options.theirs:
                run_theirs(package, cards, options.environments, folder)
            for card in cards:
                found = compare(card, folder)
                failed |= not found.worst <= MOST
                print(
                    f"{card:40} {package.name:28} network's size {found.small:.1e}, full size "
                    f"{found.full:.1e}; with a mean that is wrong by 0.01 {found.control:.1e}",
                    flush=True,
                )
                if options.write and found.worst <= MOST:
                    write(card, package, found)
                    shutil.copy(folder / card / "kept.npz", KEPT / f"{card}.npz")
    sys.exit(failed)


class Differences(NamedTuple):
    """Largest differences over the pictures."""

    small: float  #: at the network's size
    full: float  #: at the picture's size; NaN where they do not enlarge
    control: float  #: least at the network's size with a wrong mean, which shows what is seen

    @property
    def worst(self) -> float:
        """The larger one of both sizes."""
        return max(self.small, 0 if np.isnan(self.full) else self.full)


def run_theirs(package: Package, cards: list[str], environments: Path, folder: Path) -> None:
    """Run the authors' code on the pictures."""
    write_pictures(folder)
    python = environment(package, environments)
    command = [python, HERE / "authors" / "run.py", package.module, folder, *cards]
    subprocess.run([*map(str, command)], check=True, env=os.environ | {"PYTHONPATH": ""})


def compare(name: str, folder: Path) -> Differences:
    """Run the card on the pictures, and compare."""
    fields = ready_fields(name)
    fields |= {"onnx": {"opset": 18, "ir": 10} | fields.get("onnx", {})}
    card = ModelCard.from_json(json.dumps(fields))
    found = []
    for path in sorted((folder / "ours").glob("*.png")):
        frame = read_image(path)
        batch, _ = prepare(card.input, frame)
        file = folder / name / "{}x{}.onnx".format(*batch.shape[2:])
        if not file.exists():
            print(f"{name}: {file.stem} is no size of theirs for {path.name}", file=sys.stderr)
            return Differences(np.inf, np.inf, 0)
        model = Model(path=file, card=card, sha256="", size_bytes=file.stat().st_size)
        theirs = np.load(folder / name / f"{path.stem}.npz")
        found.append(of_picture(Session(model, provider="cpu"), frame, batch, theirs))
    small, full, control = zip(*found, strict=True)
    return Differences(max(small), max(full), min(control))


def of_picture(
    session: Session, frame: Frame, batch: np.ndarray, theirs: dict[str, np.ndarray]
) -> tuple[float, float, float]:
    """Differences of one picture."""
    # "has" is their mask, "at" where their depth is that of the network alone
    has = next((theirs[name] for name in ("has", "at") if name in theirs), np.True_)
    raw = theirs["raw"].reshape(theirs["raw"].shape[-2:])
    card, points, prompts = session.model.card, None, None
    if "known" in theirs:
        points = known_points(theirs["known"], frame)
        prompts = [prompt_input(card, points, frame, prepare(card.input, frame)[1])]
    ours, wrong = (session.run(one, prompts)[0] for one in (batch, batch + OFF))
    if ours.ndim > raw.ndim:  # points, of which z is compared
        ours, wrong = ours[..., 2], wrong[..., 2]
    small, control = difference(ours, raw), difference(wrong, raw)
    if "ground" in theirs:  # which has a depth, at the network's size
        mask = card.output.mask
        found = session.outputs(batch).mask[0] < mask.threshold
        small = max(small, float((found != theirs["ground"]).mean()))
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
    found = pipeline.predict(frame, Intrinsics(focal_px), points).depth.values
    both = has & np.isfinite(found)
    full = difference(np.where(both, found, np.nan), np.where(both, theirs["full"], np.nan))
    if "has" in theirs:
        print(f"of their mask, {np.mean(np.isfinite(found) != has):.0e} differ", file=sys.stderr)
    return small, full, control


def known_points(depth_m: np.ndarray, frame: Frame) -> AnchorPoints:
    """Points at the centres of the pixels of a map of the whole picture."""
    y, x = (axis.ravel() for axis in np.indices(depth_m.shape))
    rows, columns = depth_m.shape
    places = [(x + 0.5) * frame.width / columns - 0.5, (y + 0.5) * frame.height / rows - 0.5]
    return AnchorPoints.of_table(np.stack([*places, depth_m.ravel()], axis=1))


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Mean absolute difference by their standard deviation, over pixels that have depth there."""
    if ours.shape != theirs.shape:
        return np.inf
    has = np.isfinite(theirs)
    if not np.isfinite(ours[has]).all():
        return np.inf
    return float(np.abs(ours[has] - theirs[has]).mean() / theirs[has].std())


def write_pictures(folder: Path) -> None:
    """Eight pictures: NAME.png in 8 bits for them, ours/NAME.png with its own bit depth."""
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
    wanted = [*package.needs, *package.alone]
    if not done.exists() or not set(wanted) <= set(done.read_text("utf-8").split("\n")):
        pip = [str(python), "-m", "pip", "install", "-q"]
        subprocess.run([*pip, *package.needs], check=True)
        if package.alone:
            subprocess.run([*pip, "--no-deps", *package.alone], check=True)
        with done.open("a", encoding="utf-8") as listed:
            listed.write("\n".join(["", *wanted]))
    return python


def write(card: str, package: Package, found: Differences) -> None:
    """Write the result into the files of a card and of its other sizes."""
    for name in (card, *SAME.get(card, ())):
        path = FOLDER / f"{name}.json"
        fields = json.loads(path.read_text("utf-8"))
        fields["verification"] = {
            "package": package.name,
            "date": f"{datetime.now(UTC):%Y-%m-%d}",
            "pictures": 8,
            "difference": float(f"{found.small:.1e}"),
            **({} if np.isnan(found.full) else {"full_size": float(f"{found.full:.1e}")}),
            **({"note": NOTES[name]} if name in NOTES else {}),
            **({} if name == card else {"note": f"as {card}, of the same code and processing"}),
        }
        path.write_text(json.dumps(fields, indent=2, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main()
