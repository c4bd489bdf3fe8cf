"""A node of ROS 2 that publishes the depth of a camera's images.

An example that was not run on a robot. It needs rclpy and depthcli in one Python::

    python depth_node.py --ros-args -r image:=/camera/image_rect -r camera_info:=/camera/camera_info

Images have to be rectified, of encoding rgb8, bgr8 or mono8. Depth is 32FC1 in metres (REP 118).
"""

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

import depthcli

CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1}


def pixels_of(message: Image) -> np.ndarray:
    """(H, W, 3) RGB or (H, W) gray, uint8."""
    channels = CHANNELS[message.encoding]
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    pixels = pixels[..., ::-1] if message.encoding == "bgr8" else pixels
    return np.ascontiguousarray(pixels[..., 0] if channels == 1 else pixels)


class DepthNode(Node):
    """Publishes depth/image and depth/camera_info with the header of each image."""

    def __init__(self) -> None:
        super().__init__("depthcli")
        self.model = depthcli.load_model(self.declare_parameter("model", "default").value)
        self.info: CameraInfo | None = None
        self.depth = self.create_publisher(Image, "depth/image", qos_profile_sensor_data)
        self.infos = self.create_publisher(CameraInfo, "depth/camera_info", qos_profile_sensor_data)
        # Only the newest image waits while one is processed.
        newest = rclpy.qos.QoSProfile(depth=1, reliability=qos_profile_sensor_data.reliability)
        self.create_subscription(CameraInfo, "camera_info", self.on_info, newest)
        self.create_subscription(Image, "image", self.on_image, newest)

    def on_info(self, message: CameraInfo) -> None:
        """Keep the camera."""
        self.info = message

    def on_image(self, message: Image) -> None:
        """Publish the depth of an image, once its camera is known."""
        if self.info is None:
            return
        depth_m = self.model.predict(pixels_of(message), focal_px=self.info.p[0]).values
        image = Image(header=message.header, encoding="32FC1", step=4 * message.width)
        image.height, image.width = message.height, message.width
        image.data = depth_m.astype("<f4").tobytes()
        self.info.header = message.header
        self.depth.publish(image)
        self.infos.publish(self.info)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(DepthNode())
