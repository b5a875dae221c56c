"""The origin of each setting, so that an error names the file or option to correct."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bojax.config.axes import Combination
from bojax.config.errors import Location, dotted
from bojax.config.overrides import SOURCE


@dataclass(frozen=True)
class Origin:
    """The sources of a sweep's settings; the origin of a setting is the last source that sets it.

    The sources are, from first to last: the base, the sweep file, its axes, the command line.
    """

    base: Callable[[Location], str]  # formats a location in the base as `FILE: dotted.path`
    file: str  # name of the sweep file
    own: tuple[str, ...]  # reserved keys that the sweep file sets
    overridden: tuple[tuple[str, ...], ...]  # paths set on the command line
    combinations: Sequence[Combination]  # the choices of each point

    def setting(self, location: Location) -> str:
        """The origin of a reserved key."""
        if self._is_overridden(location):
            return f"{SOURCE}: {dotted(location)}"
        if location[0] in self.own:
            return f"{self.file}: {dotted(location)}"
        return self.base(location)

    def point(self, index: int, location: Location) -> str:
        """The origin of a setting of the experiment at a point."""
        if location in ((), ("kind",)):
            location = ("experiment",)
        if self._is_overridden(location):
            return f"{SOURCE}: {dotted(location)}"
        axes = self.combinations[index]
        # The last axis that sets the location or a parent of it, otherwise the first that sets a part of it.
        above = [choice for choice in axes if choice.axis == location[: len(choice.axis)]]
        below = [choice for choice in axes if location == choice.axis[: len(location)]]
        if above or below:
            choice = above[-1] if above else below[0]
            name = () if choice.name is None else (choice.name,)
            rest = location[len(choice.axis) :]
            return f"{self.file}: axes.{dotted((*choice.axis, *name, *rest))} (point {index})"
        return self.base(location)

    def _is_overridden(self, location: Location) -> bool:
        """Whether the command line sets the location, a parent of it or a part of it."""
        return any(all(a == b for a, b in zip(path, location, strict=False)) for path in self.overridden)
