"""Ray: placeholder."""

from collections.abc import Sequence
from pathlib import Path

from typing_extensions import override

from bojax.config.launching import RayConfig
from bojax.engine.remote import Launcher


class Ray(Launcher):
    """To be written."""

    is_awaited = True

    def __init__(self, config: RayConfig):
        self._config = config

    @override
    def check(self, name: str) -> None:
        return

    @override
    def start(self, name: str, folders: Sequence[Path]) -> None:
        return
