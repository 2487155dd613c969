"""Colors of objects."""

import hashlib

MATERIALS = {
    "can": (0.72, 0.20, 0.22),
    "bottle": (0.28, 0.55, 0.42),
    "mug": (0.90, 0.88, 0.82),
    "cup": (0.86, 0.84, 0.78),
    "bowl": (0.42, 0.56, 0.70),
    "box": (0.78, 0.60, 0.40),
    "brick": (0.70, 0.36, 0.26),
    "egg": (0.93, 0.83, 0.71),
    "pear": (0.69, 0.74, 0.30),
    "ball": (0.90, 0.55, 0.18),
    "jar": (0.55, 0.66, 0.72),
    "hammer": (0.45, 0.38, 0.34),
    "spray_bottle": (0.25, 0.50, 0.72),
}
"""Colors (red, green, blue) of the library's objects, after what they are made of."""

OTHER_MATERIALS = ((0.80, 0.58, 0.33), (0.50, 0.62, 0.45), (0.62, 0.50, 0.66), (0.40, 0.60, 0.66), (0.76, 0.48, 0.42))


def object_color(name: str) -> tuple[float, float, float]:
    """The color of an object: its material's, or one that its name decides.

    Args:
        name: Name of the object.

    Returns:
        Red, green, blue.
    """
    digest = hashlib.sha256(name.encode()).digest()
    return MATERIALS.get(name, OTHER_MATERIALS[digest[0] % len(OTHER_MATERIALS)])
