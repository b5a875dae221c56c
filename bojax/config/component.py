"""Schema classes: one frozen pydantic class per identifier, which is also its registration."""

import inspect
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any, ClassVar, Literal, get_args, get_origin

import pydantic
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema
from typing_extensions import override

registry: dict[str, dict[str, type["Registered"]]] = {}
"""Every schema class, by role and kind."""

IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
"""A class given by import path: `package.module:Class`."""


class Schema(pydantic.BaseModel, frozen=True):
    """A mapping of settings: no unknown keys, nothing coerced but integers to floats, no NaN or infinity."""

    model_config = pydantic.ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        """Refuse unknown keys by naming the known ones; merge what stands in a slot over its default."""
        if not isinstance(data, Mapping):
            return data
        names = [field.alias or name for name, field in cls.model_fields.items()]
        unknown = [name for name in data if name not in names]
        if unknown:
            name, names = unknown[0], [name for name in names if name != "kind"]
            kin = registry.get(getattr(cls, "role", ""), {})
            having = [kind for kind, schema in kin.items() if name in schema.model_fields]
            context = {"names": names, "others": len(unknown) - 1, "kinds": having}
            error = PydanticCustomError("unknown_key", "unknown key", context)
            details = InitErrorDetails(type=error, loc=(name,), input=data[name])
            raise pydantic.ValidationError.from_exception_data(cls.__name__, [details])
        data = dict(data)
        for name, _ in slots(cls):
            default = cls.model_fields[name].default
            if name in data and isinstance(default, Registered):
                data[name] = merged(default.model_dump(), data[name])
        return data


class Registered(Schema, frozen=True):
    """A mapping with a `kind`, which a final class pins as a `Literal` default; that registers the class.

    Attributes:
        role: The slot that it fits: "problem", "planner", "motions", ...
        kind: Its identifier.
    """

    role: ClassVar[str] = ""

    kind: str

    @classmethod
    @override
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Register a final class."""
        super().__pydantic_init_subclass__(**kwargs)
        annotation = inspect.get_annotations(cls).get("kind")
        if get_origin(annotation) is not Literal:
            return
        (kind,) = get_args(annotation)
        kinds = registry.setdefault(cls.role, {})
        if kind in kinds:
            raise TypeError(
                f"{cls.role} {kind!r} is registered twice: {kinds[kind].__name__}, {cls.__name__}"
            )
        kinds[kind] = cls


class Component(Registered, frozen=True):
    """Settings of one part, as plain numbers: what the constructor of its target takes.

    The base class of a role sets `role`, `plural` and `protocol`; the class of a part sets `target` and
    `kind`.

    Attributes:
        plural: What lists call the parts of the role.
        protocol: Base class of the parts, `package.module:Class`, whose abstract methods a part has to
            provide; empty where a role has none.
        target: The class that is built from the settings, `package.module:Class`.
        constructor_defaults: Fields that are left to the constructor unless they were set.
    """

    plural: ClassVar[str]
    protocol: ClassVar[str] = ""
    target: ClassVar[str] = ""
    constructor_defaults: ClassVar[frozenset[str]] = frozenset()

    @property
    def label(self) -> str:
        """The name that results use for it."""
        return self.kind.rpartition(":")[2]

    @property
    def imported_module(self) -> tuple[str, str] | None:
        """A module outside bojax whose code runs before the part is built, and the setting that names it."""
        return None


class External(Component, frozen=True):
    """A part given by import path, before its class has been imported.

    Attributes:
        kind: `package.module:Class`.
        slot: The role that it has to fill.
        params: Its settings, not yet validated.
    """

    slot: str
    params: dict[str, Any] = {}

    @property
    @override
    def imported_module(self) -> tuple[str, str]:
        """The module of its import path."""
        return self.kind.partition(":")[0], "kind"


class Slot:
    """Marks a field that holds a component: `problem: Annotated[Component, Slot("problem")]`.

    The field accepts a component, an identifier (`parking` means `{kind: parking}`), an import path, or a
    mapping with `kind` and settings. What the mapping leaves out is taken from the field's default if that
    is of the same kind, otherwise from the defaults of the kind.

    Attributes:
        role: The role of the component.
        only: The built-in kinds that fit, if not all of the role do.
        optional: Whether null may stand there too.
    """

    def __init__(self, role: str, only: Collection[str] = (), *, optional: bool = False):
        self.role = role
        self.only = only
        self.optional = optional

    def __get_pydantic_core_schema__(self, source: Any, handler: pydantic.GetCoreSchemaHandler) -> CoreSchema:
        """Pydantic's hook: validate by `kind`, serialise the whole component."""
        del source, handler
        return core_schema.no_info_plain_validator_function(
            self.validate,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda component, info: component and component.model_dump(mode=info.mode), info_arg=True
            ),
        )

    def validate(self, value: Any) -> Registered | None:
        """The component that `value` describes."""
        if value is None and self.optional:
            return None
        if isinstance(value, Registered):
            return self._checked(value)
        kinds = registry.get(self.role, {})
        kind = value.get("kind") if isinstance(value, Mapping) else value
        if isinstance(kind, str) and IMPORT_PATH.fullmatch(kind):
            params = {name: setting for name, setting in dict(_mapping(value)).items() if name != "kind"}
            return External(kind=kind, slot=self.role, params=params)
        if not isinstance(kind, str) or kind not in self._fitting():
            raise self._refusal(kind)
        return kinds[kind].model_validate(_mapping(value))

    def _checked(self, component: Registered) -> Registered:
        is_external = isinstance(component, External)
        role = component.slot if is_external else component.role
        if role != self.role:
            raise PydanticCustomError(
                "wrong_role", "a {role} is expected here, not a {got}", {"role": self.role, "got": role}
            )
        if self.only and not is_external and component.kind not in self.only:
            raise self._refusal(component.kind)
        return component

    def _fitting(self) -> list[str]:
        """The built-in kinds that may stand here."""
        return [kind for kind in registry.get(self.role, {}) if not self.only or kind in self.only]

    def _refusal(self, kind: Any) -> PydanticCustomError:
        is_known = isinstance(kind, str) and kind in registry.get(self.role, {})
        roles = [role for role, kinds in registry.items() if isinstance(kind, str) and kind in kinds]
        context = {
            "role": self.role,
            "kind": kind,
            "names": self._fitting(),
            "is_known": is_known,
            "roles": roles,
        }
        return PydanticCustomError("unknown_kind", "unknown kind", context)


def _mapping(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


def slots(schema: type[pydantic.BaseModel]) -> Iterator[tuple[str, Slot]]:
    """The fields of a schema that hold a component, with their slots."""
    for name, field in schema.model_fields.items():
        for mark in field.metadata:
            if isinstance(mark, Slot):
                yield name, mark


def merged(base: Any, new: Any) -> Any:
    """`new` laid over `base`: mappings key by key, but a new kind replaces the old one with its settings."""
    if isinstance(base, Mapping) and "kind" in base and isinstance(new, str):
        new = {"kind": new}
    elif isinstance(new, Mapping) and isinstance(base, str):
        base = {"kind": base}
    if not isinstance(base, Mapping) or not isinstance(new, Mapping):
        return new
    if "kind" in new and new["kind"] != base.get("kind"):
        return dict(new)
    return dict(base) | {name: merged(base.get(name), value) for name, value in new.items()}
