"""How to install what training, export and some files need; ``[train]`` in pyproject.toml.

The packages are named one by one: no package index has depthcli, so pip does not find its extras.
"""

INSTALL_TRAIN = "pip install torch lightning-fabric onnx onnxscript h5py"
INSTALL_TENSORBOARD = "pip install tensorboard"
INSTALL_H5PY = "pip install h5py"
INSTALL_RAY = "pip install ray"
INSTALL_PYARROW = "pip install pyarrow"
INSTALL_HEIF = "pip install pillow-heif"
INSTALL_CLOUD = "pip install obstore boto3"
