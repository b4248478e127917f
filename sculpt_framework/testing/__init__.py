"""Contract checks for plug-ins: what the framework relies on, as functions any package can call from its tests.

A check takes a component's config, builds the component, tries it on small analytic cases and raises
``ContractViolation`` with one line on what did not hold.
"""

from sculpt_framework.testing.components import (
    camera_at as camera_at,
)
from sculpt_framework.testing.components import (
    check_appearance as check_appearance,
)
from sculpt_framework.testing.components import (
    check_binder as check_binder,
)
from sculpt_framework.testing.components import (
    check_constraint as check_constraint,
)
from sculpt_framework.testing.components import (
    check_field as check_field,
)
from sculpt_framework.testing.components import (
    check_loss as check_loss,
)
from sculpt_framework.testing.components import (
    check_rasterizer as check_rasterizer,
)
from sculpt_framework.testing.components import (
    one_gaussian as one_gaussian,
)
from sculpt_framework.testing.components import (
    squashed as squashed,
)
from sculpt_framework.testing.components import (
    tetrahedron as tetrahedron,
)
from sculpt_framework.testing.extraction import (
    ContractViolation as ContractViolation,
)
from sculpt_framework.testing.extraction import (
    box_sdf as box_sdf,
)
from sculpt_framework.testing.extraction import (
    check_extraction as check_extraction,
)
from sculpt_framework.testing.extraction import (
    check_extractor as check_extractor,
)
from sculpt_framework.testing.extraction import (
    check_surface as check_surface,
)
from sculpt_framework.testing.extraction import (
    kept_faces as kept_faces,
)
from sculpt_framework.testing.extraction import (
    require as require,
)
from sculpt_framework.testing.extraction import (
    sphere_sdf as sphere_sdf,
)
from sculpt_framework.testing.extraction import (
    torus_sdf as torus_sdf,
)
from sculpt_framework.testing.extraction import (
    union_sdf as union_sdf,
)
