"""The pictures and videos below a prefix of an object store."""

from collections.abc import Callable, Iterator
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.io.listing.folder import InputFile, why_skipped
from depthcli.io.listing.skipped import Skipped
from depthcli.io.storage.remote import RemotePath


def list_objects(
    root: RemotePath,
    leave_out: Path,
    skip: Callable[[str], bool],
    on_skipped: Callable[[Skipped], None],
    refusal: Callable[[str], str | None] = why_skipped,
) -> Iterator[InputFile]:
    """Pictures and videos, in the order of the store, page by page.

    Args:
        root: the folder.
        leave_out: a folder that is not entered.
        skip: whether a folder of this name (from the root, with ``/``) is not entered.
        on_skipped: called with each object that is not an input.
        refusal: why an object of this URI is no input; None if it is one.

    Raises:
        UsageError: the store cannot be listed, or there is nothing below it.
    """
    out = f"{leave_out.relative_to(root)}/" if leave_out.is_relative_to(root) else None
    start, folder, is_entered = f"{root.base}/{root.key}".rstrip("/"), None, True
    try:
        for name in root.walk_names():
            above = name.rpartition("/")[0]
            if above != folder:  # names come folder by folder
                folder, is_entered = above, not _is_skipped(above, skip)
            # Some tools create an empty object for the folder itself.
            if not name or not is_entered or (out and name.startswith(out)):
                continue
            path = f"{start}/{name}"
            reason = refusal(path)
            if reason is None:
                yield InputFile(name, path)
            else:
                on_skipped(Skipped(name, reason))
    except OSError as error:
        raise UsageError(f"{root} cannot be listed: {error.strerror}") from error
    if folder is None:
        raise UsageError(f"{root} is not a folder; name one, or give --files with a list")


def walk_sort_key(name: str) -> list[tuple[bool, bytes]]:
    """Key that sorts names in the order of a walk of folders: files before folders."""
    *above, last = name.encode("utf-8", "surrogateescape").split(b"/")
    return [*((True, part) for part in above), (False, last)]


def _is_skipped(folder: str, skip: Callable[[str], bool]) -> bool:
    parts = folder.split("/") if folder else []
    return any(
        part.startswith(".") or skip("/".join(parts[: depth + 1]))
        for depth, part in enumerate(parts)
    )
