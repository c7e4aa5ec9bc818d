"""A saved scene, and what may be wrong with the attributes of its plugin."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache

import mujoco
import numpy as np
from builders.scenes import FLOOR, beam

from mjframes.base.constants import FORMAT_VERSION
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.plugin_text import decode, encode

PRINTABLE = (0.8, 0.0, -0.6, 0.0)  # MuJoCo saves six digits


@cache
def saved_beam() -> str:
    return saved(beam(beta=0.001))


def saved(body: SoftBody) -> str:
    spec = mujoco.MjSpec.from_string(FLOOR)
    attach(spec, body, "soft0", pos=(0, 0, 0.1), quat=PRINTABLE, contact=Contact(dents=True))
    spec.compile()
    return spec.to_xml()


def wrong_arrays(xml: str) -> Iterator[tuple[str, str]]:
    """Yield names and scenes in which one array of soft0 has a value more or less, or one that is no number."""
    for key, value in re.findall(r'key="(\w+)" value="([if]\d+:[1-9][^"]*)"', xml):
        array = decode(value)
        yield f"{key} and one more", xml.replace(value, encode(np.append(array, array[-1:])), 1)
        yield f"{key} but one", xml.replace(value, encode(array[:-1]), 1)
        if array.dtype.kind == "f":
            for number in (np.nan, np.inf):
                yield f"{key} with {number}", xml.replace(value, encode(np.append(array[:-1], number)), 1)


def edited(key: str, pattern: str, replacement: str) -> str:
    """The saved scene with another value of a configuration key of soft0, the first in it."""
    return re.sub(rf'(key="{key}" value=")({pattern})', rf"\g<1>{replacement}", saved_beam(), count=1)


DAMAGED = {
    "another version": (
        *("version", str(FORMAT_VERSION), "99"),
        f"its data has version '99', this plugin reads version {FORMAT_VERSION}",
    ),
    "another law": ("law", "corotational", "hooke", "law has to be 'corotational'"),
    "a law without its arrays": ("law", "corotational", "neo_hookean", "law_constants is not an array of type f64"),
    "negative damping": ("alpha", "0.0", "-1", "alpha is '-1' but has to be a number ≥ 0"),
    "no materials": ("materials", "3", "0", "materials is '0' but has to be a whole number from 1 to 65535"),
    "too many materials": (
        "materials",
        "3",
        "1e30",
        "materials is '1e30' but has to be a whole number from 1 to 65535",
    ),
    "no number": ("beta", "0.001", "much", "beta is 'much' but has to be a number ≥ 0"),
    "infinite damping": ("beta", "0.001", "inf", "beta is 'inf' but has to be a number ≥ 0"),
    "truncated": ("region_stiffness", r"(f64:\d+:.{400})[^\"]*", r"\g<3>", "region_stiffness is truncated or damaged"),
    "lengthened": ("region_stiffness", r"(f64:\d+:)", r"\g<3>AAAA", "region_stiffness is truncated or damaged"),
    "other letters": ("region_gradient", r"(f64:\d+:.{40}).", r"\g<3>*", "region_gradient is truncated or damaged"),
    "empty": ("point_rest", r"[^\"]*", "", "point_rest is not an array of type f64"),
    "other type": ("region_point", "i8", "f64", "region_point is not an array of type i32 or i16 or i8"),
    "no count": ("patch_weight", r"f64:\d+", "f64:many", "patch_weight has no valid element count"),
    "huge count": ("patch_weight", r"f64:\d+", "f64:99999999999999", "patch_weight is truncated or damaged"),
    "negative count": ("patch_weight", r"f64:\d+", "f64:-1", "patch_weight has no valid element count"),
    "fewer points": (
        "point_rest",
        r"[^\"]*",
        encode(np.zeros(6)),
        "its arrays of control points do not match each other",
    ),
    "fewer carriers": ("carrier_size", r"[^\"]*", encode(np.ones(6, int)), "it has more bodies than control points"),
    "large carriers": ("carrier_size", r"[^\"]*", encode(np.full(20, 20)), "it has more bodies than control points"),
    "points twice": (
        "carrier_point",
        r"[^\"]*",
        encode(np.zeros(20, int)),
        "its bodies do not match its control points",
    ),
    "no masses": (
        "point_mass",
        r"[^\"]*",
        encode(np.zeros(20)),
        "the masses of its control points have to be positive",
    ),
    "more points": (
        "point_rest",
        r"[^\"]*",
        encode(np.zeros(600)),
        "its arrays of control points do not match each other",
    ),
    "points out of range": ("region_point", r"[^\"]*", encode(np.full(52, 99)), "are not those of the body"),
    "negative points": ("region_point", r"[^\"]*", encode(np.full(52, -1)), "are not those of the body"),
    "unordered points": ("region_point", r"[^\"]*", encode(np.arange(52)[::-1] % 20), "not on one path of the tree"),
    "negative region": ("region_size", r"[^\"]*", encode([-4]), "its region arrays do not match each other"),
    "large region": ("region_size", r"[^\"]*", encode([2**30]), "its region arrays do not match each other"),
    "no regions": ("region_size", r"[^\"]*", encode(np.zeros(0, int)), "it has no regions"),
    "fewer patches": ("patch_size", r"[^\"]*", encode([4]), "its patch geoms do not match its patches"),
    "many clusters": ("patch_clusters", r"[^\"]*", encode([99] * 15), "its patch arrays do not match each other"),
    "empty clusters": ("patch_cluster_size", r"[^\"]*", encode([0] * 60), "a cluster of a patch has no valid size"),
    "negative lattice weights": (
        "lattice_weight",
        r"(i16:\d+:).{48}",
        r"\g<3>" + "AYAB" * 12,
        "the weights of a node of its lattice have no positive sum",
    ),
    "a zero among lattice weights": (
        "lattice_weight",
        r"(i16:\d+:).{8}",
        r"\g<3>AAAAAAAA",
        "a weight of its lattice is zero or has more than 16 bits",
    ),
    "large lattice weights": (
        "lattice_weight",
        r"[^\"]*",
        encode(np.full(10000, 40000)),
        "a weight of its lattice is zero or has more than 16 bits",
    ),
    "few lattice weights": ("lattice_weight", r"[^\"]*", encode([1]), "its lattice arrays do not match each other"),
    "many lattice weights": (
        "lattice_weight",
        r"[^\"]*",
        encode(np.ones(10**5, int)),
        "its lattice arrays do not match each other",
    ),
    "a lattice without its spacing": (
        "lattice_spacing",
        r"[^\"]*",
        "",
        "lattice_spacing is '' but has to be a number ≥ 0",
    ),
    "nodes twice": (
        "lattice_node",
        r"(i\d+:\d+:)(.{8})(.{8})",
        r"\g<3>\g<4>\g<4>",
        "its lattice's nodes are not in the lattice, in order",
    ),
    "empty sets": ("set_size", r"[^\"]*", encode([0] * 20), "its lattice arrays do not match each other"),
    "unknown sets": ("set_size", r"[^\"]*", encode([1]), "its lattice arrays do not match each other"),
    "points twice in sets": (
        "set_point",
        r"(i8:\d+:).{4}",
        r"\g<3>AAAA",
        "a set of its lattice has control points twice",
    ),
    "other points in sets": ("set_point", r"(i8:\d+:).{4}", r"\g<3>YmNk", "or not of the body"),
    "patch points": (
        "patch_point",
        r"[^\"]*",
        encode([99] * 156),
        "a patch's control points are not those of the body",
    ),
}
