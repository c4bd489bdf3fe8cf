# The types of the Python API, whose names __init__.py loads when they are used.

from depthcli._version import __version__ as __version__
from depthcli.api.depth_map import DepthMap as DepthMap, DepthPage as DepthPage
from depthcli.api.files import (
    DepthVideo as DepthVideo,
    VideoSource as VideoSource,
    read_depth as read_depth,
)
from depthcli.api.model import DepthModel as DepthModel, load_model as load_model
from depthcli.core.camera import (
    Anchor as Anchor,
    CameraSource as CameraSource,
    Intrinsics as Intrinsics,
)
from depthcli.core.options import (
    Projection as Projection,
    Upsampling as Upsampling,
    UpsamplingOptions as UpsamplingOptions,
)
from depthcli.core.surface import PointCloud as PointCloud
from depthcli.core.types import (
    AnchorFit as AnchorFit,
    DepthKind as DepthKind,
    Frame as Frame,
    Provenance as Provenance,
)
from depthcli.errors import (
    CheckpointError as CheckpointError,
    DatasetError as DatasetError,
    DepthcliError as DepthcliError,
    DepthcliWarning as DepthcliWarning,
    EngineError as EngineError,
    InputError as InputError,
    ModelError as ModelError,
    OutputError as OutputError,
    ParityError as ParityError,
    ProviderError as ProviderError,
    TrainingError as TrainingError,
    UsageError as UsageError,
)
from depthcli.inference.pipeline import Pipeline as Pipeline
from depthcli.inference.session import Session as Session
from depthcli.io.calibration import read_calibration as read_calibration
from depthcli.io.images.read import ImageLike as ImageLike, read_image as read_image
from depthcli.models.card import ModelCard as ModelCard
from depthcli.models.catalog import Model as Model, find_model as find_model
