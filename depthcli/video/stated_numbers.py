"""Numbers of frames beside their packets in Matroska, as additional data of blocks.

The header is written with the first frame, before it is known which later ones are missing.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from av.packet import PacketSideData, packet_sidedata_type_from_literal

if TYPE_CHECKING:
    from av.packet import Packet
    from av.video.stream import VideoStream

_KIND: Final = "matroska_block_additional"
_ID_BYTES = 8
_ID = 1
"""Of data that only the codec or the program defines (BlockAddID)."""


def state_number(packet: Packet[VideoStream], number: int) -> None:
    """Add the number of its frame to a packet that is not written yet."""
    data = _ID.to_bytes(_ID_BYTES) + f"{number}".encode()
    kind = packet_sidedata_type_from_literal(_KIND)
    side_data = PacketSideData(kind, len(data))  # type: ignore[call-arg] # missing in PyAV's stubs
    side_data.update(data)
    packet.set_sidedata(side_data)


def stated_number(packet: Packet[VideoStream]) -> int | None:
    """The number that a packet states for its frame; None if it states none."""
    if not packet.has_sidedata(_KIND):
        return None
    text = bytes(packet.get_sidedata(_KIND))[_ID_BYTES:]
    return int(text) if re.fullmatch(rb"\d{1,18}", text) else None
