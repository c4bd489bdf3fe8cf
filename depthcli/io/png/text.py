"""Text chunks of PNG files (PNG specification, third edition, 11.3.3)."""

from depthcli.io.png.chunks import chunk, read_chunks


def text_chunk(keyword: str, text: str) -> tuple[bytes | memoryview, ...]:
    """The parts of a chunk that holds a text, by a keyword of 1-79 Latin-1 characters.

    A text that is not Latin-1 is stored as UTF-8.
    """
    name = keyword.encode("latin-1")
    try:
        return chunk(b"tEXt", name + b"\0" + text.encode("latin-1"))
    except UnicodeEncodeError:
        return chunk(b"iTXt", name + b"\0\0\0\0\0" + text.encode())


def read_text(png: bytes) -> dict[str, str]:
    """The tEXt and uncompressed iTXt chunks of a PNG file; damaged ones are left out."""
    texts = {}
    for kind, body, _ in read_chunks(png):
        if kind not in (b"tEXt", b"iTXt"):
            continue
        keyword, _, rest = bytes(body).partition(b"\0")
        if kind == b"tEXt":
            texts[keyword.decode("latin-1")] = rest.decode("latin-1")
        elif rest.startswith(b"\0\0"):
            text = rest[2:].split(b"\0", 2)[-1]
            texts[keyword.decode("latin-1")] = text.decode("utf-8", "replace")
    return texts
