"""What results say about their origin."""

import bojax
from bojax.engine import provenance


def test_the_version_of_bojax_is_recorded_whatever_its_distribution_is_called(monkeypatch):
    monkeypatch.setattr(provenance, "installed", lambda packages: {})
    assert provenance.versions()["bojax"] == bojax.__version__
