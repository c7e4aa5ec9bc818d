"""Constants of the precomputation; each carries its unit and its reason."""

KIND = "mjframes soft body"  # what a saved soft body says it is
BODY_VERSION = 7  # of saved soft bodies
FORMAT_VERSION = 10  # of what the plugin reads; it refuses any other
VOLUME_VERSION = 1  # of saved volumes

RIGID_YOUNG = 1e10  # [Pa] cortical bone: an upper bound of what keeps an affine frame in a rigid material rigid
RIGID_RATIO = 1e3  # [-] to the stiffest soft material: its stresses then strain a rigid one by a thousandth at most
RIGID_POISSON = 0.3  # [-] cortical bone

NEGLIGIBLE_WEIGHT = 1e-3  # [-] smaller weights are dropped: a displacement error of a thousandth of the frame's own

MOST_CELLS = 2**31 - 1  # of a grid: later stages number its cells with int32
UP = ("x", "y", "z", "-x", "-y", "-z")  # axes of a file that may point up
METRES = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}

VERTICES, LEAST_VERTICES = 5000, 100  # of a surface: about how many, and the fewest that still have the shape of a body
