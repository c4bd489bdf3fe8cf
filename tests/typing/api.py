"""The Python API as its users type it; only mypy reads this file, nothing runs it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, assert_type

import numpy as np
import numpy.typing as npt
from PIL import Image

import depthcli

model = depthcli.load_model("default", provider="cpu", threads=2)
assert_type(model, depthcli.DepthModel)
assert_type(model.provider, str)
assert_type(model.card.name, str)

camera_frame = np.zeros((480, 640, 3), np.uint8)
depth = model.predict(camera_frame, focal_px=600.0, anchors=[(320, 240, 2.5)])
assert_type(depth, depthcli.DepthMap)
assert_type(depth.values, npt.NDArray[np.float32])
assert_type(depth.valid, npt.NDArray[np.bool_])
assert_type(depth.model, str | None)
assert_type(depth.focal_px, float | None)
assert_type(depth.camera_source, depthcli.CameraSource | None)
assert_type(depth.anchors, tuple[depthcli.Anchor, ...])
assert_type(depth.anchor_fit, depthcli.AnchorFit | None)
assert_type(depth.kind, depthcli.DepthKind)
assert_type(np.asarray(depth), npt.NDArray[Any])
assert_type(depth.colorize("turbo", near="black"), npt.NDArray[np.uint8])
depth.save("depth.png", png_scale=256)
depth.save("depth.png", png_inverse=True, vmin=1, vmax=20.5)
depth.save(Path("depth.exr"), half=True)
depth.save("depth.ply", centre_px=(319.5, 239.5))
depth.save("depth.glb", stride=2, max_depth_m=4)
depth.save("depth.stereo.png", stereo_layout="anaglyph", eye_distance_m=0.1)
assert_type(depth.view(keep_edges=True), depthcli.DepthPage)

cloud = depth.to_points(centre_px=(319.5, 239.5))
assert_type(cloud, depthcli.PointCloud)
assert_type(cloud.xyz_m, npt.NDArray[np.float32])
assert_type(len(cloud), int)

model.predict("room.jpg", hfov_deg=70)
model.predict("room.jpg", anchors=np.zeros((9, 3)))
model.predict("room.jpg", anchors=depthcli.read_depth("lidar.png"))
model.predict("room.jpg", anchors=np.zeros((9, 3)), anchors_fit="network")
model.predict(Path("room.jpg"), white_level=4095)
model.predict(Path("room.jpg").read_bytes())
model.predict(depthcli.read_image("room.jpg", max_pixels=10_000_000))
model.predict(depthcli.Frame(camera_frame))
model.predict(Image.open("room.jpg"))

assert_type(model.predict_many(Path().glob("*.jpg"), workers=4), Iterator[depthcli.DepthMap])
model.predict_many([camera_frame, camera_frame], batch_size=2)
model.predict_many(["a.png", "b.png"], anchors_each=[np.zeros((9, 3)), None])
model.predict_many(depthcli.VideoSource("walk.mp4").frames())

read = depthcli.read_depth("depth.exr")
depthcli.read_depth("left.png", png_scale=256, kind="disparity", focal_px=721, baseline_m=0.54)
assert_type(read, depthcli.DepthMap)
assert_type(read.fit_anchors([(0, 0, 1.5), depthcli.Anchor(9, 9, 3.0)]), depthcli.DepthMap)
assert_type(read.fit_anchors([(0, 0, 1.5)], fit="global"), depthcli.DepthMap)
for stored in depthcli.DepthVideo("walk.mkv"):
    assert_type(stored, depthcli.DepthMap)

pipeline = depthcli.load_model(
    detail=depthcli.UpsamplingOptions(depthcli.Upsampling.BILINEAR)
).pipeline
found = pipeline.predict(depthcli.Frame(camera_frame)).depth
assert_type(depthcli.DepthMap.of(found), depthcli.DepthMap)

try:
    depthcli.read_depth("missing.png")
except depthcli.DepthcliError as error:
    assert_type(error, depthcli.DepthcliError)

model.predict(3.5)  # type: ignore[arg-type]
model.predict("room.jpg", focal_px="600")  # type: ignore[arg-type]
model.predict("room.jpg", focal=600.0)  # type: ignore[call-arg]
model.predict("room.jpg", anchors=[(320, 240)])  # type: ignore[list-item]
depth.colorize(near="cold")  # type: ignore[arg-type]
depth.save("depth.png", scale=1000)  # type: ignore[call-arg]
