"""Provenance of a network: the data and steps of its run, by which runs are compared, resumed."""

import dataclasses
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias

from depthcli.core.camera import HFOV_DEG
from depthcli.core.options import Rule
from depthcli.errors import CheckpointError, DatasetError
from depthcli.lab.datasets import base, training_data
from depthcli.lab.datasets.base import NYU, DepthDataset
from depthcli.lab.datasets.training_data import TrainingData
from depthcli.lab.metrics.depth import METRICS
from depthcli.lab.training.config import Amount, Count, DataConfig, TrainConfig
from depthcli.models.card import ModelCard

_EPOCHS = ("optim.epochs_constant", "optim.epochs_decay")
PairIds: TypeAlias = dict[str, tuple[str, ...]]  #: ids of pairs by data set
_Aspect: TypeAlias = Annotated[float, Rule("a number above 0", lambda number: number > 0)]
_Score: TypeAlias = Annotated[float, Rule("a number", lambda _: True, is_finite=False)]


@dataclasses.dataclass(frozen=True, slots=True)
class DataProvenance:
    """Data that a run is trained on, and weights that it starts from."""

    data: str = training_data.NYU_PAPER  #: name of the data set, as in model cards
    train_ids: tuple[str, ...] = ()  #: pairs for training
    held_out_ids: tuple[str, ...] = ()  #: pairs for validation
    #: horizontal field of view of their camera in degrees; None if it is not known
    hfov_deg: Annotated[float, HFOV_DEG] | None = training_data.NYU_HFOV_DEG
    aspect: _Aspect = training_data.NYU_ASPECT  #: width over height of their first image
    fingerprint: str = ""  #: :func:`~depthcli.lab.datasets.base.data_fingerprint` of them
    pseudo_labels: str = ""  #: name of the pseudo labels; "" if there are none
    pseudo_label_ids: PairIds = dataclasses.field(default_factory=dict)  #: their pairs
    pseudo_label_fingerprint: str = ""  #: as ``fingerprint``, of the pseudo labels
    init_weights: str = ""  #: origin of the init weights; "" for a random initialization
    encoder_weights: str = ""  #: origin of a pretrained encoder; "" without one
    init_ids: PairIds = dataclasses.field(default_factory=dict)  #: pairs those were trained on

    @property
    def seen_ids(self) -> PairIds:
        """Pairs that the run or its init weights were trained on."""
        trained = _under_names(data_set(self.data), self.train_ids)
        return merged_ids([trained, self.pseudo_label_ids, self.init_ids])


def provenance_of(config: TrainConfig, data: TrainingData) -> DataProvenance:
    """Provenance of a run with random initial weights; no pair that it holds out has a label."""
    train_rows, held_out = train_val_split(data.dataset, config.data)
    labels = data.pseudo_labels
    origin = DataProvenance(
        data=data.title,
        train_ids=tuple(data.dataset.ids[i] for i in train_rows),
        held_out_ids=tuple(data.dataset.ids[i] for i in held_out),
        hfov_deg=data.hfov_deg,
        aspect=data.aspect,
        fingerprint=base.data_fingerprint(data.dataset),
    )
    if labels is None:
        return origin
    label_ids = _under_names(training_data.own_pairs_title(labels.root), labels.ids)
    common = common_ids(data.title, origin.held_out_ids, label_ids)
    if common:
        pairs = f"{len(common)} of the held-out pairs of {data_set(data.title)}"
        message = f"the pseudo labels contain {pairs} (first: {min(common)})"
        advice = "remove them from {pseudo_labels}, or rename them if they are other images"
        raise DatasetError(message, advice)
    return dataclasses.replace(
        origin,
        pseudo_labels=f"{len(labels)} pseudo labels ({labels.root.resolve().name})",
        pseudo_label_ids=label_ids,
        pseudo_label_fingerprint=base.data_fingerprint(labels),
    )


def train_val_split(dataset: DepthDataset, data: DataConfig) -> tuple[list[int], list[int]]:
    """Positions of the pairs to train on and to hold out: whole scenes, or the data's own parts."""
    if not data.holdout_every:
        return list(range(len(dataset))), []
    parts = dataset.official_split
    if "val" not in parts:
        held_out = base.held_out_scenes(dataset.scenes, data.holdout_every, data.holdout_offset)
        parts = tuple("val" if scene in held_out else "train" for scene in dataset.scenes)
    train_rows = [i for i, part in enumerate(parts) if part == "train"]
    return train_rows, [i for i, part in enumerate(parts) if part == "val"]


def data_set(title: str) -> str:
    """Name of a data set in records of pairs: its title, without the split of NYU Depth v2."""
    return NYU if title.startswith(NYU) else title


def _under_names(name: str, ids: tuple[str, ...]) -> PairIds:
    """Ids by data set: also NYU if all are its numbers, as a copy of it need not have an index."""
    names = (name, NYU) if all(map(base.is_label, ids)) else (name,)
    return merged_ids([dict.fromkeys(names, ids)])


def merged_ids(records: Iterable[Mapping[str, Sequence[str]]]) -> PairIds:
    """The union of several records of pairs by data set."""
    union = defaultdict[str, set[str]](set)
    for title, ids in (item for record in records for item in record.items()):
        name = data_set(title)
        union[name].update(map(base.label_id, ids) if name == NYU else ids)
    return {name: tuple(sorted(ids)) for name, ids in union.items() if ids}


def ids_of_card(card: ModelCard) -> PairIds:
    """Pairs of NYU Depth v2 that a model was trained on, as far as its card states them."""
    try:
        numbers = base.parse(str(card.training.get(base.TRAIN_IDS, "")))
    except ValueError:  # ``training`` in a card is free-form
        return {}
    return {NYU: tuple(f"{number:04d}" for number in numbers)}


def common_ids(title: str, ids: Iterable[str], record: Mapping[str, Sequence[str]]) -> set[str]:
    """Ids of a data set's pairs that are also in a record of pairs by data set."""
    name = data_set(title)
    names = set(map(base.label_id, ids)) if name == NYU else set(ids)
    return names.intersection(record.get(name, ()))


def config_differences(saved: TrainConfig, config: TrainConfig) -> tuple[str, ...]:
    """Each setting, by its name for ``--set``, with both of its values, of which one has to change.

    A run may go on for more epochs than those for which it was begun.

    >>> config_differences(TrainConfig(seed=0), TrainConfig(seed=1))
    ('seed is 0 there, 1 here',)
    """
    there, here = dict(named_settings(saved)), dict(named_settings(config))
    for name in _EPOCHS if config.optim.epochs > saved.optim.epochs else ():
        del there[name]
    return value_differences(there, here)


def named_settings(config: TrainConfig) -> Iterator[tuple[str, Any]]:
    """Each setting by its name for ``--set``."""
    for name, value in dataclasses.asdict(config).items():
        if isinstance(value, dict):
            yield from ((f"{name}.{key}", item) for key, item in value.items())
        else:
            yield name, value


def value_differences(there: Mapping[str, object], here: Mapping[str, object]) -> tuple[str, ...]:
    """Each value by its name that both have, and that differs.

    >>> value_differences({"coding": "log", "min_m": 0.4}, {"coding": "linear"})
    ('coding is "log" there, "linear" here',)
    """
    return tuple(
        f"{name} is {json.dumps(there[name])} there, {json.dumps(here[name])} here"
        for name in there
        if name in here and there[name] != here[name]
    )


def data_differences(saved: DataProvenance, current: DataProvenance) -> tuple[str, ...]:
    """Differences in data and init weights, one line each; folders may have moved.

    A run without init weights may resume one that had them.
    """
    mismatches = []
    if (saved.train_ids, saved.held_out_ids) != (current.train_ids, current.held_out_ids):
        sides = ((saved, "there"), (current, "here"))
        counts = (
            f"{len(data.train_ids)} pairs and {len(data.held_out_ids)} held out {side}"
            for data, side in sides
        )
        mismatches.append(f"the data set is another one ({', '.join(counts)})")
    elif saved.fingerprint != current.fingerprint:
        mismatches.append("the data set has other files or focal lengths")
    if saved.pseudo_label_fingerprint != current.pseudo_label_fingerprint:
        mismatches.append("the pseudo labels are others, or have other focal lengths")
    names = ("hfov_deg", "aspect", *(["init_weights"] if current.init_weights else []))
    there, here = ({name: getattr(data, name) for name in names} for data in (saved, current))
    return (*mismatches, *value_differences(there, here))


def mismatch_error(path: Path, mismatches: Sequence[str]) -> CheckpointError:
    """The error to raise for a checkpoint of another run."""
    return CheckpointError(
        f"{path} belongs to another run: {'; '.join(mismatches)}",
        "to continue it, give the same settings and data, or give another {out}",
    )


@dataclasses.dataclass(frozen=True, slots=True)
class TrainState:
    """Progress of a run."""

    step: Count = 0  #: optimization steps done
    epoch: Count = 0  #: whole epochs done
    seconds: Amount = 0.0  #: training time so far, of all sessions
    #: validation metrics after the last step by name; empty if it was not validated then
    scores: dict[str, _Score] = dataclasses.field(default_factory=dict)
    #: CPU threads of the last session, on which the last digits depend; 0 if unknown
    threads: Count = 0
    best_epoch: Count = 0  #: with the best value of the monitored metric; 0 before the first
    best_score: _Score | None = None  #: that value

    def scored(self, scores: dict[str, float], monitor: str) -> Self:
        """Progress with the scores of this epoch, which may be the best so far."""
        value, sign = scores[monitor], 1 if METRICS[monitor].higher_is_better else -1
        best = -math.inf if self.best_score is None else sign * self.best_score
        if sign * value > best:
            return dataclasses.replace(self, scores=scores, best_epoch=self.epoch, best_score=value)
        return dataclasses.replace(self, scores=scores)

    def has_stalled(self, patience: int) -> bool:
        """Whether this epoch was validated, and none of the last ``patience`` was the best."""
        return bool(patience and self.scores) and self.epoch - self.best_epoch >= patience


@dataclasses.dataclass(frozen=True, slots=True)
class TrainedRun:
    """Facts from a run's checkpoint."""

    folder: Path  #: its folder
    config: TrainConfig  #: its configuration
    state: TrainState  #: how far it has come
    provenance: DataProvenance  #: the data it was trained on
    parameters: int  #: weights of the generator

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.resolve().name

    @property
    def settings(self) -> str:
        """All settings but the seed, data and init weights, as JSON."""
        settings, data = dataclasses.replace(self.config, seed=0), self.provenance
        labels = [data.pseudo_labels, data.pseudo_label_ids, data.pseudo_label_fingerprint]
        sources = [data.data, data.train_ids, labels, data.init_weights]
        return json.dumps([dataclasses.asdict(settings), sources])
