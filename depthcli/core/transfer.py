"""Transfer functions of high dynamic range, which is not tone-mapped for the network."""

_HDR_TRANSFERS = {16: "PQ", 18: "HLG"}  # of ITU-T H.273


def transfer_warning(transfer: int, what: str, to: str) -> str | None:
    """A warning about high dynamic range; None without it.

    Args:
        transfer: code of the transfer function in ITU-T H.273.
        what: what has it.
        to: what to convert it to.
    """
    name = _HDR_TRANSFERS.get(transfer)
    if name is None:
        return None
    return (
        f"the colours are high dynamic range ({name}) and are taken as they are stored; for better "
        f"depth, convert the {what} to {to} first"
    )
