"""onnxruntime without telemetry, which it has from 1.31 on."""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it is read by the import, and only there

import onnxruntime as ort

__all__ = ["ort"]
