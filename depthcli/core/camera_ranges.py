"""Ranges of focal lengths, depths of known points, values of white, and exposures."""

from depthcli.core.validation import Rule

HFOV_DEG = Rule("an angle from 0.1 to 179.9 degrees", lambda deg: 0.1 <= deg <= 179.9)  # noqa: PLR2004
"""Horizontal fields of view; outside this range, depths would be almost zero or infinite."""
FOCAL_PX = Rule("a number from 0.001 to 1e8", lambda px: 1e-3 <= px <= 1e8)  # noqa: PLR2004
"""Focal lengths in pixels: what these angles give at any width of a picture."""
CENTRE_PX = Rule("a number from -1e6 to 1e6", lambda px: abs(px) <= 1e6)  # noqa: PLR2004
"""Principal points in pixels, in x and in y; a crop may have it outside the picture."""
DEPTH_M_RANGE = 1e-3, 1e6
"""Least and largest depth of known points in metres."""
DEPTH_M = Rule(
    "a depth from 0.001 to 1000000", lambda depth_m: DEPTH_M_RANGE[0] <= depth_m <= DEPTH_M_RANGE[1]
)
"""Depths of known points in metres."""
WHITE_LEVEL = Rule("a whole number from 1 to 65535", lambda level: 1 <= level <= 0xFFFF)  # noqa: PLR2004
"""Values of white in 16-bit pictures."""
EXPOSURE = Rule("a number of stops from -20 to 20", lambda stops: abs(stops) <= 20)  # noqa: PLR2004
"""Exposures of pictures of linear light."""
