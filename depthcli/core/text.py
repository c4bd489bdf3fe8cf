"""Text that others wrote, such as names of files, made fit for one line."""

_LARGEST = 2**63
_LONGEST = 60


def one_line(text: str) -> str:
    """Text with everything that is not printable escaped: file names may hold any byte."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown(value: object) -> str:
    """A value of foreign data for a message: short, and of printable ASCII alone."""
    if isinstance(value, int) and abs(value) >= _LARGEST:  # its digits can take for ever
        return "a number of more than 64 bits"
    try:
        text = one_line(ascii(value))  # that of a tensor has lines
    except (RecursionError, ValueError):  # a number within it is as long
        return "something too deep or too long"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
