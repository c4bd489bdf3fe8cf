"""Types of configuration fields with their allowed ranges."""

from typing import Annotated, TypeAlias

from depthcli.core.validation import Rule

LARGEST = 1e9  # beyond, 32-bit floats overflow
Count: TypeAlias = Annotated[int, Rule("a whole number from 0 up", lambda n: n >= 0)]
Positive: TypeAlias = Annotated[int, Rule("a whole number from 1 up", lambda n: n >= 1)]
Seed: TypeAlias = Annotated[
    int, Rule(f"a whole number from 0 to {2**32 - 1}", lambda n: 0 <= n < 2**32)
]  # as NumPy takes it
Amount: TypeAlias = Annotated[float, Rule("a number from 0 to 1e30", lambda x: 0 <= x <= 1e30)]
Share: TypeAlias = Annotated[float, Rule("a number from 0 to below 1", lambda x: 0 <= x < 1)]
UnitInterval: TypeAlias = Annotated[float, Rule("a number from 0 to 1", lambda x: 0 <= x <= 1)]
PositiveFloat: TypeAlias = Annotated[
    float, Rule("a number from 0.001 to 1e9", lambda x: 1e-3 <= x <= LARGEST)
]
Zoom: TypeAlias = Annotated[float, Rule("a number from 1 to 100", lambda x: 1 <= x <= 100)]
Aspect: TypeAlias = Annotated[float, Rule("a number from 1/4 to 4", lambda x: 1 / 4 <= x <= 4)]
LEAST_SIDE_PX = 32  # below, discriminators have no output and the gradient loss no coarsest scale
Side: TypeAlias = Annotated[
    int, Rule("a whole number from 32 to 4096", lambda n: LEAST_SIDE_PX <= n <= 4096)
]
# Above these limits (and that of Side), building the networks would fill memory or take too long.
Width: TypeAlias = Annotated[int, Rule("a whole number from 1 to 1024", lambda n: 1 <= n <= 1024)]
Blocks: TypeAlias = Annotated[int, Rule("a whole number from 1 to 128", lambda n: 1 <= n <= 128)]
