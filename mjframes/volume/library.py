"""Elastic constants of common soft materials, each with where it is from.

They are moduli of small, slow strains, but for the silicones of Smooth-On, whose bulletins give the stress at a
strain of 100 %: a neo-Hookean rubber with that stress has 1.7 times the modulus at small strains. Specimens of tissue
differ by factors: they are a start, not a measurement.
Poisson's ratio of what hardly changes its volume is 0.49 for rubbers and 0.45 for tissue, which finite elements take.
"""

from __future__ import annotations

from typing import NamedTuple


class Known(NamedTuple):
    """A material of the library.

    young: [Pa], None for a rigid one.  poisson: [-].  density: [kg/m³].
    rgba: how it is drawn.
    source: of modulus and density.
    """

    young: float | None
    poisson: float
    density: float
    rgba: tuple[float, float, float, float]
    source: str


_WHITE, _SKIN, _PINK = (0.9, 0.88, 0.82, 1.0), (0.89, 0.72, 0.62, 1.0), (0.72, 0.36, 0.34, 1.0)
_RED, _YELLOW, _BLUE, _GREY = (
    (0.58, 0.09, 0.11, 1.0),
    (0.96, 0.89, 0.6, 1.0),
    (0.6, 0.75, 0.85, 1.0),
    (0.4, 0.4, 0.42, 1.0),
)
_ITIS = "density: IT'IS Foundation, tissue properties database 4"


def _smooth_on(product: str, modulus: int) -> str:
    """The source of a silicone.  modulus: at 100 % strain [psi]."""
    return f"{product}. Smooth-On, technical bulletin of the series: 100 % modulus {modulus} psi, specific gravity"


LIBRARY = {
    "silicone-00-10": Known(5.5e4, 0.49, 1040, _WHITE, _smooth_on("Ecoflex 00-10", 8)),
    "silicone-00-30": Known(6.9e4, 0.49, 1070, _WHITE, _smooth_on("Ecoflex 00-30", 10)),
    "silicone-00-50": Known(8.3e4, 0.49, 1070, _WHITE, _smooth_on("Ecoflex 00-50", 12)),
    "silicone-10a": Known(1.52e5, 0.49, 1070, _WHITE, _smooth_on("Dragon Skin 10", 22)),
    "silicone-20a": Known(3.38e5, 0.49, 1080, _WHITE, _smooth_on("Dragon Skin 20", 49)),
    "silicone-30a": Known(5.93e5, 0.49, 1080, _WHITE, _smooth_on("Dragon Skin 30", 86)),
    "pdms": Known(
        1.32e6,
        0.49,
        1030,
        _BLUE,
        "Sylgard 184, 10:1, cured at 25 °C. Johnston et al., J. Micromech. Microeng. 24 (2014) 035017; density: Dow",
    ),
    "tpu-85a": Known(1.2e7, 0.48, 1190, _GREY, "NinjaFlex. NinjaTek, data sheet: tensile modulus, specific gravity"),
    "foam": Known(
        2.8e4,
        0.3,
        30,
        _GREY,
        "flexible polyurethane, open cells: 45 MPa (ρ / 1200 kg/m³)². Gibson and Ashby, Cellular Solids (1997), ch. 5",
    ),
    "fat": Known(3.25e3, 0.45, 911, _YELLOW, f"of the breast. Samani et al., Phys. Med. Biol. 52 (2007) 1565; {_ITIS}"),
    "muscle": Known(
        1.2e4, 0.45, 1090, _RED, f"skeletal, at rest. Engler et al., J. Cell Biol. 166 (2004) 877; {_ITIS}"
    ),
    "liver": Known(5.5e3, 0.45, 1079, _PINK, f"healthy, in vivo. Roulot et al., J. Hepatol. 48 (2008) 606; {_ITIS}"),
    "brain": Known(
        1.9e3, 0.45, 1041, _PINK, f"white matter. Budday et al., J. Mech. Behav. Biomed. Mater. 46 (2015) 318; {_ITIS}"
    ),
    "skin": Known(
        4.2e5,
        0.45,
        1109,
        _SKIN,
        f"in its plane, below 30 years. Agache et al., Arch. Dermatol. Res. 269 (1980) 221; {_ITIS}",
    ),
    "cartilage": Known(
        6e5, 0.1, 1100, _BLUE, f"of the knee, drained. Athanasiou et al., J. Orthop. Res. 9 (1991) 330; {_ITIS}"
    ),
    "bone": Known(None, 0.3, 1908, _WHITE, f"cortical, taken as rigid; {_ITIS}"),
}
