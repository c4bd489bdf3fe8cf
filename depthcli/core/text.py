"""Untrusted text, such as names of files, made safe to show in one line.

How to install what training, export and some files need; ``[train]`` in pyproject.toml.

The packages are named one by one: no package index has depthcli, so pip does not find its extras.
"""

_MAX_CHARS = 60


def one_line(text: str) -> str:
    """Text with everything that is not printable escaped: file names may hold any byte."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def short_repr(value: object) -> str:
    """An untrusted value for a message: short, and of printable ASCII characters only."""
    text = one_line(ascii(value))  # that of a tensor has lines
    return text if len(text) <= _MAX_CHARS else f"{text[:_MAX_CHARS]}..."


INSTALL_TRAIN = "pip install torch lightning-fabric onnx onnxscript h5py timm"
INSTALL_TENSORBOARD = "pip install tensorboard"
INSTALL_H5PY = "pip install h5py"
INSTALL_RAY = "pip install ray"
INSTALL_PYARROW = "pip install pyarrow"
INSTALL_HEIF = "pip install pillow-heif"
INSTALL_FORMATS = "pip install OpenImageIO"
INSTALL_CLOUD = "pip install obstore boto3"
