"""The inputs of a batch, and the names of their outputs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.core.camera import Intrinsics
from depthcli.io.listing.folder import InputFile, is_video
from depthcli.io.listing.skipped import (
    Skipped,
    conversion_hint,
)
from depthcli.io.manifest.shard import WHOLE, Shard
from depthcli.jobs.tree_names import StemCounts, TreeNames


@dataclass(frozen=True, slots=True)
class Plan:
    """All inputs of a batch."""

    out: Path  #: the output folder
    inputs: tuple[InputFile, ...]  #: in an order that depends on their names only
    names: TreeNames  #: names of their outputs
    skipped: tuple[Skipped, ...]  #: files that are no inputs
    loops: tuple[str, ...] = ()  #: links to a folder above them
    unmatched: tuple[str, ...] = ()  #: patterns of ``--include`` that no picture or video matches
    #: paths of the inputs, of all shards, that lie in the output folder
    inputs_in_out: frozenset[str] = frozenset()
    shard: Shard = WHOLE  #: the part of the inputs that is planned
    #: by input of a list: files beside it, not in the batch, whose outputs may have had its names
    unlisted: Mapping[str, Sequence[str]] = field(default_factory=dict)
    #: cameras of a table, by input; the others are not in it
    lenses: Mapping[str, Intrinsics] = field(default_factory=dict)
    stems: StemCounts = field(default_factory=StemCounts)  #: of the pictures of all shards
    is_part: bool = False  #: whether other files of the folder may be inputs of other batches
    camera_warnings: tuple[str, ...] = ()  #: what in that table matches no input, and vice versa

    @property
    def warnings(self) -> Iterator[str]:
        """Warnings before the start, one line each."""
        yield from self.camera_warnings
        for word in self.unmatched:
            yield f"--include {word!r} matches no picture or video"
        unreadable = conversion_hint(self.skipped)
        if unreadable:
            yield unreadable

    @property
    def pictures(self) -> Iterator[InputFile]:
        """All inputs but videos."""
        return (found for found in self.inputs if not is_video(found.name))

    @property
    def videos(self) -> Iterator[InputFile]:
        """The videos."""
        return (found for found in self.inputs if is_video(found.name))

    def folders(self) -> set[Path]:
        """The folders of the outputs."""
        return {self.out, *((self.out / found.name).parent for found in self.inputs)}
