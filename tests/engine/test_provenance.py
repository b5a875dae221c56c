"""What results say about their origin."""

import equinox as eqx

import bojax
from bojax.engine import provenance
from bojax.engine.build import build
from bojax.robots.models import from_file, mujoco
from bojax.robots.settings import MJX
from bojax.robots.simulator import Physics, Simulated, Simulator


def test_the_version_of_bojax_is_recorded_whatever_its_distribution_is_called(monkeypatch):
    monkeypatch.setattr(provenance, "installed", lambda packages: {})
    assert provenance.versions()["bojax"] == bojax.__version__


class Mass(Simulated):
    """A robot whose MJCF includes another file, and reads a mesh."""

    physics: Physics
    file: str = eqx.field(static=True)

    @property
    def simulator(self):
        return Simulator(self.physics, from_file(self.file), substeps=1)


def test_a_robot_with_another_model_is_other_code(tmp_path):
    """A sweep that was resumed after a change of the XML had runs of both models."""
    folders = [tmp_path / "light", tmp_path / "heavy"]  # whose files have the same names
    for folder in folders:
        folder.mkdir()

    def hashes(*sizes, timestep=0.01, height=1):
        for folder, size in zip(folders, sizes, strict=True):
            option = f'<option timestep="{timestep}"/>'
            mesh = '<asset><mesh file="shape.obj"/></asset>'
            (folder / "mass.xml").write_text(f'<mujoco>{option}{mesh}<include file="body.xml"/></mujoco>')
            corners, faces = (
                f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {height}\n",
                "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
            )
            (folder / "shape.obj").write_text(corners + faces)
            body = f'<body><joint/><geom size="{size}"/><geom type="mesh" mesh="shape"/></body>'
            (folder / "body.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        mujoco.mj_clearCache(mujoco.mj_getCache())  # of meshes, which a new process has not read
        physics = build(MJX(), "float32")
        return provenance.code_hashes([Mass(physics, str(folder / "mass.xml")) for folder in folders])

    before = hashes(1, 2)
    assert before == hashes(1, 2) and set(before) == {"bojax", "mass.xml", __name__}
    changed = hashes(3, 2), hashes(1, 3), hashes(1, 2, timestep=0.01000000001), hashes(1, 2, height=2)
    for after in changed:
        assert [name for name in before if before[name] != after[name]] == ["mass.xml"]
