"""What is public, and where it is: `__init__.py` reads it, and imports a name when it is used first."""
# ruff: noqa: I001

from .app.collect.run import Collection as Collection, collect as collect
from .app.dented import draw_dents as draw_dents
from .app.log.options import Log as Log
from .app.run import record as record
from .app.video import film as film, look_from as look_from, still as still
from .base.errors import MjframesError as MjframesError
from .body.build import TurnWarning as TurnWarning, build as build
from .body.options import Paper as Paper
from .body.soft_body import SoftBody as SoftBody
from .frames.supports import Attached as Attached, Fixed as Fixed
from .scene.attach import (
    Attachment as Attachment,
    BranchWarning as BranchWarning,
    FloatWarning as FloatWarning,
    attach as attach,
)
from .scene.contact import Contact as Contact
from .scene.detach import detach as detach
from .scene.inertia import mass_matrix as mass_matrix, rigid_inertia as rigid_inertia
from .scene.instability import InstabilityWarning as InstabilityWarning
from .scene.load import load_scene as load_scene
from .scene.muscles import Muscle as Muscle
from .scene.near import near as near
from .scene.placing import place as place
from .scene.scaling import scale as scale
from .scene.sensors import add_sensor as add_sensor
from .scene.taxels import TaxelGrid as TaxelGrid, add_taxels as add_taxels
from .scene.solver import choose_solver as choose_solver
from .scene.tendons import Chamber as Chamber, Fibre as Fibre
from .scene.view import Soft as Soft, soft as soft
from .volume.images import ImageWarning as ImageWarning
from .volume.material import Material as Material
from .volume.meshes import MeshWarning as MeshWarning
from .volume.pieces import load_pieces as load_pieces
from .volume.volume import Volume as Volume
from .weights.kernels import Harmonic as Harmonic, Linear as Linear, Voronoi as Voronoi
from .whole_body.contrast import RigidWarning as RigidWarning

__all__: list[str]
__version__: str
