"""onnxruntime without telemetry: from 1.31 on it connects to a server of its makers."""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it is read by the import, and only there

import onnxruntime as ort

__all__ = ["ort"]
