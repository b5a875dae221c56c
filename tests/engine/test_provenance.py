"""What results say about their origin."""

import equinox as eqx

import bojax
from bojax.engine import provenance
from bojax.engine.build import build
from bojax.robots.models import from_file
from bojax.robots.settings import MJX
from bojax.robots.simulator import Physics, Simulated, Simulator


def test_the_version_of_bojax_is_recorded_whatever_its_distribution_is_called(monkeypatch):
    monkeypatch.setattr(provenance, "installed", lambda packages: {})
    assert provenance.versions()["bojax"] == bojax.__version__


class Mass(Simulated):
    """A robot whose MJCF includes another file."""

    physics: Physics
    file: str = eqx.field(static=True)

    @property
    def simulator(self):
        return Simulator(self.physics, from_file(self.file), substeps=1)


def test_a_robot_with_another_model_is_other_code(tmp_path):
    """A sweep that was resumed after a change of the XML had runs of both models."""
    (tmp_path / "mass.xml").write_text('<mujoco><include file="body.xml"/></mujoco>')

    def hashes(size):
        body = f'<body><joint/><geom size="{size}"/></body>'
        (tmp_path / "body.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        return provenance.code_hashes([Mass(build(MJX(), "float32"), str(tmp_path / "mass.xml"))])

    before, same, after = hashes(1), hashes(1), hashes(2)
    assert before == same and set(before) == {"bojax", "mass.xml", __name__}
    assert [name for name in before if before[name] != after[name]] == ["mass.xml"]
