"""Which pairs a network has seen: those of its own training and those of its initial weights."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from depthcli.datasets import id_ranges
from depthcli.datasets.splits import NYU, TRAIN_IDS, is_label, label_id
from depthcli.datasets.training_data import OWN_PAIRS, OWN_PICTURES, TrainingData, own_pairs_title
from depthcli.errors import DatasetError
from depthcli.models.card import ModelCard
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import Checkpoint, RunProgress


def data_set(title: str) -> str:
    """The name under which the pairs of a data set are recorded, of its name in model cards.

    All splits of NYU Depth v2 share one, and so do the pairs of a folder and its pictures alone.
    """
    return NYU if title.startswith(NYU) else title.replace(OWN_PICTURES, OWN_PAIRS, 1)


def seen_by_run(progress: RunProgress) -> dict[str, tuple[str, ...]]:
    """Ids of the pairs that a run or its initial weights were trained on, by data set."""
    ids = (*progress.train_ids, *progress.start_ids)
    own = _under_names(data_set(progress.data), ids)
    return _merged([own, progress.extra_pairs, progress.start_pairs])


def extra_pairs(data: TrainingData) -> dict[str, tuple[str, ...]]:
    """Ids of the extra pairs by data set; empty if there are none."""
    if data.extra is None:
        return {}
    return _under_names(own_pairs_title(data.extra.root), data.extra.ids)


def _under_names(name: str, ids: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Ids by data set: also NYU if all are its numbers, as a copy of it need not have an index."""
    names = (name, NYU) if all(map(is_label, ids)) else (name,)
    return _merged([dict.fromkeys(names, ids)])


def check_extra_pairs(data: TrainingData, held_out_ids: Iterable[str]) -> None:
    """Check that the extra pairs have none of the pairs that the run holds out.

    Raises:
        DatasetError: they have some.
    """
    extra = extra_pairs(data)
    common = common_pairs(data, held_out_ids, extra)
    if common:
        number = f"{len(common)} held-out pair{'s' * (len(common) != 1)}"
        raise DatasetError(
            f"the extra pairs contain {number} of {data_set(data.title)} (first: {min(common)}): "
            "remove them from --extra, or rename them if they are other pictures"
        )


def common_pairs(
    data: TrainingData, ids: Iterable[str], seen: Mapping[str, Sequence[str]]
) -> set[str]:
    """Those of some pairs of a data set that are also in a record of pairs by data set."""
    name = data_set(data.title)
    known = set(map(label_id, ids)) if name == NYU else set(ids)
    return known.intersection(seen.get(name, ()))


def seen_by_files(paths: Sequence[Path]) -> dict[str, tuple[str, ...]]:
    """Ids of the pairs that the weights of any file were trained on, by data set.

    Args:
        paths: checkpoints and exported models; none is fine. The card of a model states its pairs
            of NYU Depth v2 only.

    Raises:
        CheckpointError: a checkpoint cannot be read.
        ModelError: a model cannot be read.
    """
    return _merged(
        _stated(find_model(path).card)
        if path.suffix == ".onnx"
        else seen_by_run(Checkpoint.load(path).progress)
        for path in paths
    )


def _stated(card: ModelCard) -> dict[str, tuple[str, ...]]:
    try:
        numbers = id_ranges.parse(str(card.training.get(TRAIN_IDS, "")))
    except ValueError:  # ``training`` in a card is free-form
        return {}
    return {NYU: tuple(f"{number:04d}" for number in numbers)}


def _merged(records: Iterable[Mapping[str, Sequence[str]]]) -> dict[str, tuple[str, ...]]:
    found: dict[str, set[str]] = {}
    for record in records:
        for name, ids in record.items():
            is_nyu = data_set(name) == NYU
            found.setdefault(data_set(name), set()).update(map(label_id, ids) if is_nyu else ids)
    return {name: tuple(sorted(ids)) for name, ids in found.items() if ids}
