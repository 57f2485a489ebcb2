"""The point of contact is on the ellipsoid and in the plane, at every scale."""

from __future__ import annotations

import numpy as np
import pytest
from rerun_runs import BODY

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.rotation import rotate
from rb_dynamics.theory.poinsot_contact import contact, separatrices


@pytest.mark.parametrize("rate", [1e-200, 1e-9, 1e9, 1e150])
def test_contact_does_not_depend_on_the_scale_of_the_spin(rate: float) -> None:
    attitude = np.array([[0.5, 0.5, 0.5, 0.5]])
    omega = np.array([[0.1, 2.0, 0.3]])
    one, other = contact(BODY, attitude, omega), contact(BODY, attitude, rate * omega)
    np.testing.assert_allclose(other.body, one.body, rtol=1e-14)
    np.testing.assert_allclose(other.distance, one.distance, rtol=1e-14)
    point = one.body[0]
    inertia = np.array(BODY.inertia) / min(BODY.principal_moments)
    assert point @ inertia @ point == pytest.approx(1.0, rel=1e-14)
    gradient = rotate((0.5, 0.5, 0.5, 0.5), tuple(inertia @ point))
    np.testing.assert_allclose(gradient / np.linalg.norm(gradient), one.normal[0], rtol=0, atol=1e-15)


def test_separatrices_lie_on_the_ellipsoid_and_have_the_momentum_of_the_middle_axis() -> None:
    inertia = np.array(BODY.inertia) / min(BODY.principal_moments)
    middle = sorted(BODY.principal_moments)[1] / min(BODY.principal_moments)
    curves = separatrices(BODY)
    assert len(curves) == 2
    for curve in curves:
        np.testing.assert_allclose(np.einsum("ni,ij,nj->n", curve, inertia, curve), 1.0, rtol=1e-13)
        np.testing.assert_allclose(np.sum((curve @ inertia) ** 2, axis=1), middle, rtol=1e-13)
    assert separatrices(RigidBody.from_principal(1.0, (1.0, 1.0, 1.5), rotation.exp((0.1, 0.2, 0.3)))) == []
