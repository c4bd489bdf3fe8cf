"""onnxruntime, which tells its makers nothing: from 1.31 on it would connect to them."""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it is read by the import, and only there

import onnxruntime as ort

__all__ = ["ort"]
