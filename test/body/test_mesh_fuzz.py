"""Any mesh file gives either a physically possible solid or a `BodyError`."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rb_dynamics.body.mesh import FORMATS, read_solid
from rb_dynamics.errors import BodyError

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")

BOXES = {suffix: trimesh.creation.box((1.0, 2.0, 3.0)).export(file_type=suffix[1:]) for suffix in FORMATS}
edits = st.lists(
    st.tuples(
        st.floats(0.0, 1.0),
        st.integers(0, 9),
        st.binary(max_size=9)
        | st.sampled_from([b" nan ", b"1e999", b"-1", b"99999999999", b"\n", b"f 1/2/3 4 5 6 7\n"]),
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=120, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(suffix=st.sampled_from(FORMATS), changes=edits)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_box_with_bytes_replaced_added_or_removed(
    tmp_path: Path, suffix: str, changes: list[tuple[float, int, bytes]]
) -> None:
    data = BOXES[suffix] if isinstance(BOXES[suffix], bytes) else BOXES[suffix].encode()
    for part, gone, come in changes:
        place = int(part * len(data))
        data = data[:place] + come + data[place + gone :]
    path = tmp_path / f"box{suffix}"
    path.write_bytes(data)
    with contextlib.suppress(BodyError):
        solid = read_solid(path)
        assert solid.volume > 0.0
        assert all(map(math.isfinite, (*solid.center_of_mass, solid.reach)))
