"""Predictors, which give one depth map per image: models, files of other tools, baselines."""

import math
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from depthcli.core.camera import Intrinsics, hfov_deg
from depthcli.core.options import DEFAULT_UPSAMPLING, DepthEncoding, DepthFit, UpsamplingOptions
from depthcli.core.parallel import NO_PROGRESS, Progress, ordered_map
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import DatasetError
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import NETWORK_FROM, Pipeline
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import READABLE
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions, StoredDepth
from depthcli.known.points import KnownDepth
from depthcli.lab.datasets.base import DepthDataset, Pair
from depthcli.lab.datasets.folders import as_dataset_error
from depthcli.lab.datasets.layouts import list_files
from depthcli.lab.datasets.prompts import Pattern, Prompt
from depthcli.lab.evaluation.protocol import HEADLINE, EvalProtocol
from depthcli.lab.evaluation.report import Source
from depthcli.lab.training.provenance import TrainedRun

SUFFIXES = tuple(f"{middle}{f.facts.file_suffix}" for f in READABLE for middle in ("", ".depth"))
"""Suffixes of predictions in order of precision; those with ``.depth`` are of ``predict``."""
TRIVIAL_NAMES = ("constant mean", "per-pixel mean")  #: of :func:`fit_trivial`, in its order


class Sample:
    """One image of a data set, decoded on first access, with what that states of its camera."""

    def __init__(self, dataset: DepthDataset, position: int) -> None:
        self.id = dataset.ids[position]
        focal_px = dataset.focal_px[position] if dataset.focal_px else None
        self.camera = Intrinsics(focal_px, None if focal_px else dataset.hfov_deg)
        self.dataset, self._position = dataset, position

    @cached_property
    def frame(self) -> Frame:
        """The image."""
        return self.dataset.frame(self._position)

    def known_points(self, prompt: Prompt) -> KnownDepth:
        """Points of the true depth, the same whenever they are drawn."""
        depth_m = self.dataset.depth_m(self._position)
        gray = cv2.resize(self.frame.pixels_8bit().max(2), depth_m.shape[::-1])
        random = np.random.default_rng(self._position)
        drawn_m = prompt.draw(depth_m, np.asarray(gray, np.float32), random)
        return KnownDepth.of_map(drawn_m)


@dataclass(frozen=True, slots=True)
class Predictor(ABC):
    """Predicts depth for one row of the table, or for several with different alignments."""

    name: str  #: name of the row
    source: Source  #: origin of its predictions
    kind: DepthKind  #: kind of its depth
    stated: str  #: kind and unit of its numbers and who states them, for tables

    @abstractmethod
    def predict(self, sample: Sample) -> DepthMap:
        """Depth of one image, any size."""


@dataclass(frozen=True, slots=True)
class ModelPredictor(Predictor):
    """A model, run in the same way as by ``depthcli predict``; of a training run, a seed of it."""

    pipeline: Pipeline  #: the inference pipeline
    run: TrainedRun | None = None  #: the training run that the model is of
    latency_ms: float = math.nan  #: median of the network for one image; NaN if not measured
    prompt: Prompt | None = None  #: known depth that it is given; None for none
    fit: DepthFit | None = None  #: how its depth is fitted to that; None for the best it can

    def predict(self, sample: Sample) -> DepthMap:
        """Depth at the image's size."""
        drawn = sample.known_points(self.prompt) if self.prompt else None
        points = replace(drawn, fit=self.fit) if drawn else None
        return self.pipeline.predict(sample.frame, sample.camera, points).depth


def open_model(
    loader: SessionLoader,
    detail: UpsamplingOptions = DEFAULT_UPSAMPLING,
    prompt: Prompt | None = None,
    fit: DepthFit | None = None,
) -> ModelPredictor:
    """Find a model and load it; with known depth, its depth is metric.

    The default model gives way to the one that takes known depth.
    """
    session = loader.load()
    has_many = prompt and (prompt.size >= NETWORK_FROM or prompt.pattern is Pattern.LIDAR)
    if has_many and fit in {None, DepthFit.NETWORK}:
        session = session.known_depth or session
    pipeline = Pipeline(session, detail)
    name = str(loader.model or pipeline.card.name)
    kind = DepthKind.METRIC if prompt else pipeline.card.output.kind
    unit = f"{kind}, m" if kind is DepthKind.METRIC else kind
    return ModelPredictor(name, Source.MODEL, kind, unit, pipeline, prompt=prompt, fit=fit)


@dataclass(frozen=True, slots=True)
class FilePredictor(Predictor):
    """A folder of depth files that another tool wrote."""

    files: Mapping[str, Path]  #: of each image, by its id
    reading: DepthReadOptions = AS_STATED  #: what is known about them
    warnings: tuple[str, ...] = ()  #: about the first file, one line each

    def predict(self, sample: Sample) -> DepthMap:
        """Depth of one image as it was written, any size."""
        path = self.files[sample.id]
        stored = _read(path, self.reading, sample)
        if stored.depth.kind is not self.kind:
            kinds = f"{stored.depth.kind} depth, and the first file {self.kind} depth"
            raise DatasetError(f"{path} states {kinds}", "evaluate them in folders of their own")
        return stored.displayed


def open_predictions(
    folder: Path, samples: Sequence[Sample], reading: DepthReadOptions = AS_STATED
) -> FilePredictor:
    """Check that a folder has a file for every image, named by its id (``ID.npy``) or as it is."""
    if not folder.is_dir():
        raise DatasetError(f"{folder} is not a folder", "give one that holds ID.npy, .exr or .png")
    ids, by_suffix = (
        [sample.id for sample in samples],
        _depth_files(folder, samples[0].dataset.pairs),
    )
    missing = {suffix: [i for i in ids if i not in files] for suffix, files in by_suffix.items()}
    suffix = min(SUFFIXES, key=lambda s: len(missing[s]))
    if missing[suffix]:
        message = f"lacks {len(missing[suffix])} of {len(ids)} predictions"
        example = f"(first: {missing[suffix][0]}{suffix})"
        advice = "every image of the split needs one that is named by its id, or as the image"
        raise DatasetError(f"{folder} {message} {example}", advice)
    files = {i: by_suffix[suffix][i] for i in ids}
    if several := next((paths for paths in files.values() if len(paths) > 1), None):
        raise DatasetError(f"{several[0]} and {several[1]} are of one image", "remove one")
    first = _read(files[ids[0]][0], reading, samples[0])
    kind, unit, warnings = first.depth.kind, str(first.depth.kind), first.warnings
    if first.depth.is_metric:  # others are fitted to the truth, whatever their scale
        unit, warnings = (
            f"{kind}, {first.unit_text}",
            first.warnings_with_scale("predictions_scale"),
        )
    reading = reading if reading.kind else replace(reading, kind=DepthEncoding(kind))
    paths = {image_id: path for image_id, (path,) in files.items()}
    return FilePredictor(str(folder), Source.FILES, kind, unit, paths, reading, warnings)


def _depth_files(folder: Path, pairs: Sequence[Pair]) -> dict[str, dict[str, list[Path]]]:
    """The depth files of each image, by suffix and id.

    An image has the name of its id, and the ends of its path that no other image has.
    """
    ids_of = defaultdict[str, set[str]](set)
    for pair in pairs:
        parts = pair.image.with_suffix("").parts if pair.image else ()
        for i in range(len(parts)):
            ids_of["/".join(parts[i:])].add(pair.id)
    id_of = {name: min(ids) for name, ids in ids_of.items() if len(ids) == 1}
    id_of |= {pair.id: pair.id for pair in pairs}
    files = {suffix: defaultdict[str, list[Path]](list) for suffix in SUFFIXES}
    for file in list_files(folder):
        for suffix in filter(file.endswith, SUFFIXES):
            if image_id := id_of.get(file.removesuffix(suffix)):
                files[suffix][image_id].append(folder / file)
    return {suffix: dict(paths) for suffix, paths in files.items()}


def _read(path: Path, reading: DepthReadOptions, sample: Sample) -> StoredDepth:
    if reading.kind in {DepthEncoding.DISTANCE, DepthEncoding.DISPARITY}:
        focal_px, width = sample.camera.focal_px, sample.frame.pixels.shape[1]
        across_deg = hfov_deg(focal_px, width) if focal_px else sample.camera.hfov_deg
        if across_deg is None:
            message = f"{path} holds {reading.kind}, which needs the focal length"
            raise DatasetError(message, "give it in cameras.csv")
        reading = replace(reading, camera=Intrinsics(hfov_deg=across_deg))
    with as_dataset_error():
        return read_stored_depth(path, reading)


@dataclass(frozen=True, slots=True)
class TrivialPredictor(Predictor):
    """A baseline that ignores the image: one depth map for all, metres."""

    depth: DepthMap  #: the map

    def predict(self, sample: Sample) -> DepthMap:
        """The map."""
        del sample
        return self.depth


def fit_trivial(
    dataset: DepthDataset,
    train: Sequence[int],
    protocol: EvalProtocol = HEADLINE,
    progress: Progress = NO_PROGRESS,
    workers: int = 0,
) -> tuple[TrivialPredictor, ...]:
    """Constant and per-pixel mean of the training depth in the range of the protocol.

    Each pair is read once, in constant memory; with 0 workers, by the calling thread.
    """
    sums, counts = np.array([]), np.array([], np.int64)
    advance = progress.begin("mean of training images", len(train))
    with closing(ordered_map(dataset.depth_m, train, workers=workers)) as maps:
        for i, depth_m in zip(train, maps, strict=True):
            if not counts.size:
                sums, counts = np.zeros(depth_m.shape), np.zeros(depth_m.shape, np.int64)
            if depth_m.shape != sums.shape:
                message = f"depth of {dataset.ids[i]} has another size than the others"
                raise DatasetError(message, "leave out the baselines with {no_trivial}")
            valid_mask = (depth_m > protocol.min_m) & (depth_m < protocol.max_m)
            np.add(sums, depth_m, out=sums, where=valid_mask)
            counts += valid_mask
            advance(1)
    if not counts.any():
        raise DatasetError("no training depth to take the mean of: baselines need training pairs")
    mean_m = float(sums.sum() / counts.sum())
    # A pixel that was never valid, for example in a corner, gets the constant mean.
    per_pixel_m = np.divide(sums, counts, out=np.full_like(sums, mean_m), where=counts > 0)
    means_m = np.full(sums.shape, mean_m, np.float32), per_pixel_m.astype(np.float32)
    return tuple(
        TrivialPredictor(name, Source.TRIVIAL, DepthKind.METRIC, "metric, m", DepthMap(values))
        for name, values in zip(TRIVIAL_NAMES, means_m, strict=True)
    )
