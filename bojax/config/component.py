"""Base classes of settings: one frozen pydantic class per kind of part, registered by its definition."""

import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Literal, get_args, get_origin

import pydantic
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema
from typing_extensions import override

registry: dict[str, dict[str, type["Registered"]]] = {}
"""Every schema class, by role and kind."""

IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
"""Pattern of an import path: `package.module:Class`."""

RECORDED = object()
"""Context of a validation of settings that results record: files that they name may have gone or changed."""


class Schema(pydantic.BaseModel, frozen=True):
    """A mapping of settings without unknown keys, NaN or infinity; only integers are converted, to floats."""

    model_config = pydantic.ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, defer_build=True, serialize_by_alias=True
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        """Refuse unknown keys, listing the known ones; merge the value of each slot into its default."""
        if not isinstance(data, Mapping):
            return data
        names = [field.alias or name for name, field in cls.model_fields.items()]
        unknown = [name for name in data if name not in names]
        if unknown:
            name, names = unknown[0], [name for name in names if name != "kind"]
            role = getattr(cls, "role", "")
            owners = [kind for kind, schema in registry.get(role, {}).items() if name in schema.model_fields]
            fields = cls.model_fields.items()
            mappings = [key for key, field in fields if role and get_origin(field.annotation) is dict]
            context = {"names": names, "role": role, "kinds": owners, "open": mappings}
            context["others"] = len(unknown) - 1
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
    """Settings with a `kind`. A final class pins `kind` as a `Literal` default, which registers the class."""

    role: ClassVar[str] = ""  # role of the part: "problem", "planner", "motions", ...

    kind: str  # identifier, unique within the role

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
    """Settings of one part: the arguments of its constructor, as plain values.

    The base class of a role sets `role`, `plural` and `protocol`; the class of a part sets `target` and
    `kind`.
    """

    plural: ClassVar[str]  # heading of the role in lists
    # Base class of the parts, `package.module:Class`, whose abstract methods a part must implement; or empty
    protocol: ClassVar[str] = ""
    target: ClassVar[str] = ""  # class that is built from the settings, `package.module:Class`
    # Settings that are passed to the constructor only if they were set
    constructor_defaults: ClassVar[frozenset[str]] = frozenset()

    @property
    def label(self) -> str:
        """Name of the part in results."""
        return self.kind.rpartition(":")[2]

    @property
    def imported_module(self) -> tuple[str, str] | None:
        """The module outside bojax that is imported to build the part, and the setting that names it."""
        return None


def import_target(target: str) -> type:
    """The class at `package.module:Class`."""
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)


class External(Component, frozen=True):
    """A part given by import path, `package.module:Class`, before its class has been imported."""

    slot: str  # role that the part must have
    params: dict[str, Any] = {}  # settings, not yet validated

    @property
    @override
    def imported_module(self) -> tuple[str, str] | None:
        """The module of the import path."""
        return self.kind.partition(":")[0], "kind"


class Built(External, frozen=True):
    """A part given as an object, which Python code has built; `kind` is the import path of its class."""

    value: Any

    @property
    @override
    def imported_module(self) -> None:
        """None: the class is there already."""
        return None


class Slot:
    """Marks a field that holds a component: `problem: Annotated[Component, Slot("problem")]`.

    The field accepts a component, an identifier (`parking` means `{kind: parking}`), an import path, or a
    mapping with `kind` and settings. Settings that the mapping omits are taken from the default of the field
    if its kind is the same, otherwise from the defaults of the kind. From Python, it also accepts an object
    of the base class of the role. With `optional`, it accepts null.
    """

    def __init__(self, role: str, only: type[Registered] | None = None, *, optional: bool = False):
        self.role, self.optional = role, optional
        self.only = only  # settings class from which the allowed built-in kinds derive; None: all of the role

    def __get_pydantic_core_schema__(self, source: Any, handler: pydantic.GetCoreSchemaHandler) -> CoreSchema:
        """Validate by `kind` and serialise the whole component; called by pydantic."""
        del source, handler
        return core_schema.with_info_plain_validator_function(
            lambda value, info: self.validate(value, info.context),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda component, info: component and component.model_dump(mode=info.mode), info_arg=True
            ),
        )

    def validate(self, value: Any, context: Any = None) -> Registered | None:
        """The component that `value` describes, validated in a context of pydantic."""
        if value is None and self.optional:
            return None
        if isinstance(value, Registered):
            return self._checked(value)
        kinds = registry.get(self.role, {})
        if (built := self._built(value)) is not None:
            return built
        kind = value.get("kind") if isinstance(value, Mapping) else value
        if isinstance(kind, str) and IMPORT_PATH.fullmatch(kind):
            params = {name: setting for name, setting in dict(_mapping(value)).items() if name != "kind"}
            return External(kind=kind, slot=self.role, params=params)
        if not isinstance(kind, str) or kind not in self._allowed_kinds():
            raise self._unknown_kind(kind)
        return kinds[kind].model_validate(_mapping(value), context=context)

    def _checked(self, component: Registered) -> Registered:
        is_external = isinstance(component, External)
        role = component.slot if is_external else component.role
        if role != self.role:
            raise ValueError(f"allowed: a part of role {self.role}, not of role {role}")
        if self.only and not is_external and component.kind not in self._allowed_kinds():
            raise self._unknown_kind(component.kind)
        return component

    def _built(self, value: Any) -> Built | None:
        """An object that the slot accepts: of a built-in class of the role, or of its base class."""
        name = f"{type(value).__module__}:{type(value).__qualname__}"
        if name.startswith("builtins:"):  # a name, a mapping, or a mistake
            return None
        kinds: dict[str, Any] = registry.get(self.role, {})
        same = [kind for kind, schema in kinds.items() if getattr(schema, "target", "") == name]
        if same and not set(same) & set(self._allowed_kinds()):
            raise self._unknown_kind(same[0])
        protocol = next((getattr(schema, "protocol", "") for schema in kinds.values()), "")
        is_accepted = same or (protocol and isinstance(value, import_target(protocol)))
        return Built(kind=name, slot=self.role, value=value) if is_accepted else None

    def _allowed_kinds(self) -> list[str]:
        """The built-in kinds that this slot accepts."""
        kinds = registry.get(self.role, {})
        return [kind for kind, schema in kinds.items() if self.only is None or issubclass(schema, self.only)]

    def _unknown_kind(self, kind: Any) -> PydanticCustomError:
        roles = [role for role, kinds in registry.items() if isinstance(kind, str) and kind in kinds]
        context = {"role": self.role, "kind": kind, "names": self._allowed_kinds(), "roles": roles}
        return PydanticCustomError("unknown_kind", "unknown kind", context)


def _mapping(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


def slots(schema: type[pydantic.BaseModel]) -> Iterator[tuple[str, Slot]]:
    """The fields of a schema that hold a component, with their slots."""
    for name, field in schema.model_fields.items():
        if slot := slot_of(field):
            yield name, slot


def slot_of(field: FieldInfo) -> Slot | None:
    """The slot of a field that holds a component; None for a plain setting."""
    return next((mark for mark in field.metadata if isinstance(mark, Slot)), None)


def merged(base: Any, new: Any) -> Any:
    """`new` merged into `base`, mappings key by key; a new kind replaces the old kind and its settings."""
    if isinstance(base, Mapping) and "kind" in base and isinstance(new, str):
        new = {"kind": new}
    elif isinstance(new, Mapping) and isinstance(base, str):
        base = {"kind": base}
    if not isinstance(base, Mapping) or not isinstance(new, Mapping):
        return new
    if "kind" in new and new["kind"] != base.get("kind"):
        return dict(new)
    return dict(base) | {name: merged(base.get(name), value) for name, value in new.items()}
