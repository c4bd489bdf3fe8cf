"""Adding, removing and verifying models in the user's folder; downloads; new cards."""

import errno
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from depthcli.core import options, parallel, types, validation
from depthcli.errors import DepthcliError, ModelError, OutputError, UsageError, os_errors_as
from depthcli.inference.pipeline import try_other_size, try_session
from depthcli.inference.session import Session, ort
from depthcli.io.guard import Guard
from depthcli.io.storage import atomic, paths
from depthcli.models import card as cards, catalog
from depthcli.models.card import METADATA_KEY, Colour, DataFile, ModelCard, WeightsSpec

_NAME = re.compile(r"(?!.*\.onnx$)[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_ADDED_FILE = re.compile(r"model-[0-9a-f]{12}\.onnx")
_LITTER = (".DS_Store", "._", ".depthcli-")  # of file managers, and of runs that were killed


def valid_name(name: str) -> str:
    """A name that a model may have; UsageError if it cannot be a folder's, or seems a path."""
    if not _NAME.fullmatch(name):
        problem = f"{name!r} is not a valid model name"
        raise UsageError(problem, "use letters, digits, '.', '_' and '-'")
    return name


def folder_to_add(name: str, *, force: bool) -> Path:
    """The folder of a new model; UsageError if it is taken, a link, or holds other files."""
    target = catalog.user_root() / name
    taken = dict(catalog.list_locations()).get(name)
    if taken is not None and not force:
        problem = f"a model named {name!r} already exists ({taken.path})"
        raise UsageError(problem, "give another {name}, or {force}")
    if target.is_symlink():
        raise UsageError(f"{target} is a link; remove it first: depthcli models remove {name}")
    if target.is_dir():
        _check_only_model(target, "give another {name}")
    return target


def added_model(name: str) -> tuple[Path, catalog.ModelLocation]:
    """Folder and files of a model that was added; UsageError if there is none, or other files."""
    folder = catalog.user_root() / valid_name(name)
    location = catalog.location_at(folder) or catalog.location_at(
        folder.with_name(f"{folder.name}.onnx")
    )
    if location is None:
        problem = f"{name!r} is not among the models in {catalog.user_root()}"
        raise UsageError(problem, "only those are removed")
    if location.onnx is None and not folder.is_symlink():
        _check_only_model(folder, "move them away, or delete the folder yourself")
    return folder, location


def remove_model(name: str) -> Path:
    """Delete a model that was added, and return its path; raises as :func:`added_model`."""
    folder, location = added_model(name)
    if location.onnx is not None:  # a file, beside which a folder may have the same name
        for file in {location.onnx, location.path}:
            file.unlink()
    elif folder.is_symlink():
        folder.unlink()
    else:
        with atomic.workspace(folder.parent) as work:
            folder.rename(work / folder.name)
    return location.onnx or folder


def _check_only_model(folder: Path, advice: str) -> None:
    """Check that replacing or removing a folder loses nothing but a model, such as a checkpoint."""
    of_model = {catalog.CARD_NAME, *catalog.files_of_card(folder / catalog.CARD_NAME)}
    others = [
        name
        for name in sorted(path.name for path in folder.iterdir())
        if not (name in of_model or _ADDED_FILE.fullmatch(name) or name.startswith(_LITTER))
    ]
    if others:
        raise UsageError(f"{folder} also holds {', '.join(others[:3])}", advice)


_FILE_NAME = "model.onnx"


class CardDraft(NamedTuple):
    """A card's JSON object before the facts of the model file are added."""

    fields: dict[str, Any]  #: the object
    where: str  #: name of its source in messages
    is_ready: bool  #: whether it is a ready card, whose input size may differ from the model's

    def card(self, onnx: Mapping[str, object], **facts: str | None) -> ModelCard:
        """The card with facts of the model file, and the output that it names itself."""
        section = self.fields.get("onnx")
        if isinstance(section, dict) and "output" in section:
            onnx = {**onnx, "output": section["output"]}
        fields = self.fields | {"onnx": onnx}
        fields |= {name: fact for name, fact in facts.items() if fact is not None}
        return ModelCard.from_json(json.dumps(fields), where=self.where)


class PublishedModel(NamedTuple):
    """A card whose ONNX file can be downloaded."""

    source: str  #: name of the ready card, or its file
    card: ModelCard  #: with placeholders for opset and IR version
    weights: WeightsSpec  #: those of the card
    url: paths.RemotePath  #: of the ONNX file


def published_model(name: str) -> PublishedModel | None:
    """The model that the name of a ready card, or a ``.json`` file, stands for; None if neither.

    UsageError if the card states no address of an ONNX file, ModelError if it is no card.
    """
    if name not in catalog.ready_names() and not name.endswith(".json"):
        return None
    draft = _named_draft(name)
    card = draft.card(catalog.NO_FILE_YET)
    url = paths.path_of(card.weights.url or "") if card.weights else None
    if card.weights is None or not isinstance(url, paths.RemotePath):
        problem = f"{draft.where} states no address of an ONNX file"
        raise UsageError(problem, catalog.how_to_add(card, name))
    return PublishedModel(name, card, card.weights, url)


def add_model(
    source: Path | PublishedModel,
    card: str | None = None,
    *,
    name: str | None = None,
    force: bool = False,
    sha256: str | None = None,
    progress: parallel.Progress = parallel.NO_PROGRESS,
) -> catalog.Model:
    """Copy a model into the user's folder with its completed card, after running it once.

    A remote ONNX file is downloaded, which advances ``progress``. The card is a ``card.json`` or
    the name of a ready one; None if it is inside the file, or beside it on this machine; a
    published model has its own. ``force`` replaces a model of this name, by default the card's, or
    overrides a bundled one; ``sha256`` is the checksum that the file must have, by default the
    published one.
    """
    if isinstance(source, PublishedModel):
        card, sha256 = source.source, sha256 or source.weights.sha256
        name = name or source.card.name
    if name is not None:
        folder_to_add(valid_name(name), force=force)  # before anything is downloaded
    with _opened(source, name or "", sha256, progress) as file:
        return _install(file, card, name=name, force=force, sha256=sha256)


@contextmanager
def _opened(
    source: Path | PublishedModel, name: str, sha256: str | None, progress: parallel.Progress
) -> Iterator[Path]:
    """The local file of a model, or a download, removed after the block.

    If the checksum of a published one is known, a download that was interrupted goes on where it
    stopped.
    """
    if not isinstance(source, PublishedModel):
        with paths.local_copy(source, progress, max_bytes=catalog.MAX_BYTES) as file:
            yield file
        return
    part = catalog.user_root() / f".{name}.part"
    with os_errors_as(OutputError, f"{part} cannot be written"):
        part.parent.mkdir(parents=True, exist_ok=True)
        handle = atomic.open_locked(part)
    if handle is None:
        raise UsageError(f"another process writes {part}; wait for its end")
    try:
        with os.fdopen(handle, "r+b") as download, paths.errors_about(source.url, part):
            if sha256 is None:  # the part may be that of another file
                download.truncate(0)
            _download(source, download, progress)
            try:
                yield part
            except ModelError:
                download.truncate(0)
                raise
            download.truncate(0)
    finally:
        if part.stat().st_size == 0:
            part.unlink()


def _download(model: PublishedModel, file: BinaryIO, progress: parallel.Progress) -> None:
    size = model.weights.size_bytes
    if size is not None and file.seek(0, os.SEEK_END) >= size:
        return
    try:
        paths.download(model.url, file, progress, max_bytes=catalog.MAX_BYTES)
        file.flush()
    except OSError as error:
        if error.errno == errno.ERANGE:  # it is complete, or else its checksum is wrong
            return
        raise ModelError(
            f"{model.url} cannot be downloaded: {error.strerror}",
            "try again to go on where it stopped, or download it elsewhere and run: depthcli "
            f"models add FILE {{card}} {model.source}",
        ) from error


def _install(
    path: Path, card: str | None, *, name: str | None, force: bool, sha256: str | None
) -> catalog.Model:
    (size, checksum), facts = catalog.checksum(path), catalog.onnx_facts(path)
    data = _data_files(path, facts)
    if sha256 is not None and checksum != sha256.lower():
        raise ModelError(f"{path} is another file: its sha256 is {checksum}; it is not added")
    draft = _card_draft(path, facts, card)
    complete = draft.card({"opset": facts.opset, "ir": facts.ir}, file=_FILE_NAME, name=name)
    valid_name(complete.name)
    catalog.check_file(complete, path, size, checksum)
    complete = replace(complete, sha256=checksum, size_bytes=size, data=data)
    target = folder_to_add(complete.name, force=force)
    if target.is_dir():  # the old one is kept until the new card is in place
        complete = replace(complete, file=f"model-{checksum[:12]}.onnx")
    with atomic.workspace(target.parent) as work:
        temporary = work / target.name
        temporary.mkdir()
        shutil.copyfile(path, temporary / (complete.file or _FILE_NAME))
        for file in data:
            shutil.copyfile(path.with_name(file.file), temporary / file.file)
        (temporary / catalog.CARD_NAME).write_text(complete.to_json(), "utf-8")
        model = replace(catalog.find_model(temporary), path=path)  # the name in messages
        session = Session(model, provider="cpu")
        fitted = cards.fit_to_graph(complete, session.fixed_size, path, adapt=draft.is_ready)
        session.model = replace(model, card=fitted)
        try_session(session)
        try:
            try_other_size(session)
        except ModelError:
            if not draft.is_ready:
                raise
            only = fitted.input.height, fitted.input.width
            fitted = cards.fit_to_graph(fitted, only, path, adapt=True)
            session.model = replace(model, card=fitted)
            try_session(session)
        (temporary / catalog.CARD_NAME).write_text(fitted.to_json(), "utf-8")
        atomic.replace_folder(temporary, target, last=catalog.CARD_NAME)
    return catalog.find_model(target)


def _data_files(path: Path, facts: catalog.OnnxFacts) -> tuple[DataFile, ...]:
    """The files beside an ONNX file with the rest of its weights; ModelError if one is missing."""
    names = sorted(facts.external)
    for name in names:
        if not name or name != Path(name).name:
            raise ModelError(f"{path} keeps weights in {name!r}, which is not a file beside it")
    sums = [(name, *catalog.checksum(path.with_name(name))) for name in names]
    return tuple(DataFile(name, sha256, size) for name, size, sha256 in sums)


def _card_draft(path: Path, facts: catalog.OnnxFacts, card: str | None) -> CardDraft:
    if card is None:
        location = catalog.location_at(path)
        card = str(location.card) if location and location.card else None
    if card is None:
        embedded = facts.metadata.get(METADATA_KEY)
        if embedded is None:
            problem = f"{path} has no card inside or beside it{catalog.unused_card(path)}"
            ready = "see 'depthcli models cards' for ready ones"
            raise UsageError(problem, f"give {{card}}; {ready}, or {catalog.how_to_write(path)}")
        where = f"card inside {path}"
        return CardDraft(_json_object(embedded, where), where, is_ready=False)
    return _named_draft(card)


def _named_draft(card: str) -> CardDraft:
    if card.endswith(".json") or paths.path_of(card).is_file():
        fields = _json_object(catalog.read_limited(paths.path_of(card)), paths.safe_name(card))
        return CardDraft(fields, card, is_ready=False)
    return CardDraft(catalog.ready_fields(card), f"card {card}", is_ready=True)


def _json_object(text: str | bytes, where: str) -> dict[str, Any]:
    try:
        return validation.validated(dict[str, Any], validation.parsed_json(text))
    except validation.FieldError as refused:
        raise ModelError(f"{where}: {refused}; correct it") from None


def verify_models(names: Sequence[str] = ()) -> Iterator[tuple[str, catalog.Model | DepthcliError]]:
    """Check size, checksum and card of models, all by default, and run each on gray images.

    Yields each name or path with its model, or with what is wrong with it.
    """
    for name in names or [name for name, _ in catalog.list_locations()]:
        try:
            model = catalog.find_model(name)
            session = Session(model)
            try_session(session)
            try_other_size(session)
        except DepthcliError as error:
            yield name, error
        else:
            yield name, model


_IMAGENET = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_USUAL_PX, _PATCH_PX = 518, 14  # of the networks with a vision transformer that people export
_MAX_M = 20.0
_IMAGE_RANK = 4
_KINDS = {types.DepthKind.INVERSE: "disp|inv", types.DepthKind.METRIC: "metric|metre|meter"}


class Answers(NamedTuple):
    """What the user states about a network; None for a guess."""

    kind: types.DepthKind | None = None  #: what its numbers mean
    colour: Colour | None = None  #: its channels
    mean: tuple[float, ...] | None = None  #: subtracted from colours in [0, 1]
    std: tuple[float, ...] | None = None  #: divisor after that
    output: str | None = None  #: name of the output that is the depth map


def new_card(
    model: Path, out: Path | None, answers: Answers, *, overwrite: bool
) -> tuple[Path, list[str]]:
    """Write a card for an ONNX file, by default ``NAME.card.json`` beside it.

    Returns its path, and guesses to check, one line each.
    UsageError if several outputs could be the depth map, ModelError if the file is no network of
    images.
    """
    facts, session = catalog.onnx_facts(model), _session(model)
    layout, channels, size_px = _image_shape(session.get_inputs(), model)
    output = _depth_output(session.get_outputs(), answers.output)
    guesses = list[str]()

    def guess(name: str, stated: Any, guessed: Any, why: str) -> Any:  # noqa: ANN401 - of an option
        if stated is not None:
            return stated
        text = ",".join(map(str, guessed)) if isinstance(guessed, tuple) else guessed
        guesses.append(f"{name} is {text}: {why}")
        return guessed

    words = f"{model.name} {output}".lower()
    by_name = next((kind for kind, word in _KINDS.items() if re.search(word, words)), None)
    why = "larger is nearer" if by_name in {None, types.DepthKind.INVERSE} else "by its name"
    kind = guess("output.kind", answers.kind, by_name or types.DepthKind.INVERSE, why)
    is_rgb, is_dynamic = channels == Colour.RGB.channels, None in size_px
    of_input = f"usual where an input has {channels} channels"
    colour = guess("input.colour", answers.colour, Colour.RGB if is_rgb else Colour.LUMA, of_input)
    mean, std = _IMAGENET if is_rgb else ((0.5,), (0.5,))
    spec = {
        "colour": colour,
        "width": size_px[1] or _USUAL_PX,
        "height": size_px[0] or _USUAL_PX,
        "dynamic": is_dynamic,
        "multiple_of": _PATCH_PX if is_dynamic else 1,
        "fit": "keep-aspect" if is_dynamic else "stretch",
        "mean": guess("input.mean", answers.mean, mean, of_input),
        "std": guess("input.std", answers.std, std, of_input),
        "layout": layout,
    }
    matrices = [entry.name for entry in session.get_inputs()[1:] if entry.shape[-2:] == [3, 3]]
    if matrices:
        spec["camera_matrix"] = guess("input.camera_matrix", None, matrices[-1], "by its shape")
    if is_dynamic:
        size = f"{_USUAL_PX}, and multiple_of {_PATCH_PX}"
        guesses.append(f"input.width and height are {size}: the file accepts any size")
    depth = {"kind": kind, "transform": "linear", "scale": 1.0, "shift": 0.0}
    if kind is types.DepthKind.METRIC:
        depth |= {"min_m": 0.0, "max_m": guess("output.max_m", None, _MAX_M, "depth is clipped")}
        guesses.append("camera is null: metres do not follow the focal length")
    fields = {
        "schema": cards.SCHEMA,
        "name": re.sub(r"[^A-Za-z0-9._-]+", "-", model.stem).strip("-.") or "model",
        "version": "1.0.0",
        "summary": f"{model.name}, with a card that was guessed in part",
        "license": guess("license", None, "LicenseRef-unknown", "the file does not state it"),
        "input": spec,
        "output": depth,
        "camera": None,
        "onnx": {"opset": facts.opset, "ir": facts.ir, "output": output},
        "file": model.name,
    }
    text = ModelCard.from_json(json.dumps(fields), where="the new card").to_json()
    path = out or model.with_name(model.stem + catalog.CARD_SUFFIX)
    Guard.of([model], overwrite=overwrite).check(path)
    with atomic.atomic_path(path) as temporary:
        temporary.write_text(text, "utf-8")
    return path, guesses


def _session(model: Path) -> ort.InferenceSession:
    try:
        return ort.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    except Exception as error:
        reason = options.one_line(str(error))
        raise ModelError(f"onnxruntime cannot load {model}: {reason}") from error


def _image_shape(
    inputs: Sequence[Any], model: Path
) -> tuple[str, int, tuple[int | None, int | None]]:
    """Layout, channels, and height and width of the image's input; None where it is dynamic."""
    for entry in inputs:
        for layout, axis in (("nchw", 1), ("nhwc", 3)):
            if len(entry.shape) == _IMAGE_RANK and entry.shape[axis] in {1, 3}:
                sides = [side if isinstance(side, int) else None for side in entry.shape]
                channels = sides.pop(axis)
                return layout, channels or 1, (sides[1], sides[2])
    listed = ", ".join(f"{entry.name} {entry.shape}" for entry in inputs)
    raise ModelError(f"{model} has no input of an image of 1 or 3 channels, but {listed}")


def _depth_output(outputs: Sequence[Any], stated: str | None) -> str:
    names = [entry.name for entry in outputs]
    if stated in names or (stated is None and len(names) == 1):
        return stated or str(names[0])
    raise UsageError(
        f"the outputs are {', '.join(names)}", "name the depth map", option="depth_output"
    )
