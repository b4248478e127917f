"""Which components, methods and export formats there are, by name; none is imported before it is asked for.

Two sources: the table of built-ins (``sculpt_plugins/builtin.py``) and the entry points of installed packages, one
group per slot (``sculpt_framework.fields`` and so on), ``sculpt_framework.methods`` and ``sculpt_framework.exporters``.
What is in neither goes by its place, "module:class", once its module is imported: a notebook's own loss needs no
package.
A package that is broken, or that takes a name another one has, disturbs nothing until that name is chosen.
"""

import difflib
import functools
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from importlib.metadata import EntryPoint, distributions
from typing import cast, get_type_hints

from sculpt_framework.config import (
    AppearanceConfig,
    BackgroundConfig,
    BinderConfig,
    ComponentConfig,
    ConstraintConfig,
    DatasetConfig,
    ExporterConfig,
    ExtractorConfig,
    FieldConfig,
    InitializerConfig,
    LossConfig,
    MethodConfig,
    ObserverConfig,
    RasterizerConfig,
)
from sculpt_framework.errors import ComponentImportError, ConfigError, UnknownComponentError, first_line
from sculpt_plugins.builtin import BUILTIN, EXPORTERS, METHODS

OWN_PACKAGE = "gaussian-sculpting"
GROUPS = "sculpt_framework"
METHOD_GROUP = f"{GROUPS}.methods"


@dataclass(frozen=True, kw_only=True)
class Slot:
    """A place in the pipeline that components compete for."""

    name: str
    """Field of MethodConfig and option on the command line."""
    one: str
    """What one component of the slot is called."""
    base: type[ComponentConfig]
    """Base class of the slot's configs."""
    many: bool = False
    """The slot takes a list of components."""

    @property
    def group(self) -> str:
        """Entry-point group of packages that bring more of them: the plural of the slot's name."""
        return f"{GROUPS}.{self.name}" if self.many else f"{GROUPS}.{self.name}s"


SLOTS: Mapping[str, Slot] = {
    slot.name: slot
    for slot in (
        Slot(name="field", one="field", base=FieldConfig),
        Slot(name="extractor", one="extractor", base=ExtractorConfig),
        Slot(name="binder", one="binder", base=BinderConfig),
        Slot(name="appearance", one="appearance", base=AppearanceConfig),
        Slot(name="rasterizer", one="rasterizer", base=RasterizerConfig),
        Slot(name="background", one="background", base=BackgroundConfig),
        Slot(name="initializer", one="initializer", base=InitializerConfig),
        Slot(name="dataset", one="dataset", base=DatasetConfig),
        Slot(name="losses", one="loss", base=LossConfig, many=True),
        Slot(name="constraints", one="constraint", base=ConstraintConfig, many=True),
        Slot(name="observers", one="observer", base=ObserverConfig, many=True),
    )
}

_EXPORTER = Slot(name="exporter", one="export format", base=ExporterConfig)
"""No place in the pipeline: it comes after a run."""


def slots_of(kind: type[MethodConfig]) -> Mapping[str, Slot]:
    """The slots a method uses, by its config class: its fields that are components, or tuples of such."""
    return {each.name: SLOTS[each.name] for each in fields(kind) if each.name in SLOTS}


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Something registered, not yet imported."""

    name: str
    package: str
    """Name of the installed distribution it comes from."""
    value: str
    """Where it is: "module:attribute"."""

    def load(self, what: str) -> object:
        """Import it. Raises ComponentImportError, which calls it ``what`` and names the package and the cause."""
        try:
            return EntryPoint(name=self.name, value=self.value, group="").load()
        except Exception as error:  # Whatever a broken package raises while it is imported.
            cause = first_line(error)
            raise ComponentImportError(
                f"{what} {self.name!r} of package {self.package!r} cannot be imported from {self.value!r} ({cause}). "
                f"Repair or uninstall that package, or choose another {what}."
            ) from error

    def is_loaded_as(self, kind: type) -> bool:
        """Whether ``kind`` is what loading gives. If it is, its module has been imported already."""
        module, _, attribute = self.value.partition(":")
        found: object = sys.modules.get(module)
        for part in attribute.split("."):
            found = getattr(found, part, None)
        return found is kind


def names(slot: str) -> tuple[str, ...]:
    """Names registered in ``slot``: built-ins first, in the table's order, then the others by the alphabet."""
    return tuple(_candidates(SLOTS[slot].group, BUILTIN[slot]))


def load(slot: str, name: str) -> type[ComponentConfig]:
    """The config class registered as ``name`` in ``slot``.

    Raises UnknownComponentError, or ComponentImportError where its package is broken or the name is taken twice.
    """
    return _load(SLOTS[slot], BUILTIN[slot], name)


def default(slot: str, name: str) -> ComponentConfig:
    """The component's config as it is when nothing is set. Raises what ``load`` raises."""
    return _default(SLOTS[slot], BUILTIN[slot], name)


def export_formats() -> tuple[str, ...]:
    """Names of all export formats, in the order of ``names``."""
    return tuple(_candidates(_EXPORTER.group, EXPORTERS))


def default_exporter(name: str) -> ExporterConfig:
    """The export format's config as it is when nothing is set. Raises what ``load`` raises."""
    return cast(ExporterConfig, _default(_EXPORTER, EXPORTERS, name))


def slot_of(config: ComponentConfig) -> Slot:
    """The slot a component's config belongs to."""
    for slot in SLOTS.values():
        if isinstance(config, slot.base):
            return slot
    raise ConfigError(f"{type(config).__name__} belongs to no slot: it is derived from none of their config classes.")


def name_of(config: ComponentConfig) -> str:
    """The name a component's config class is registered under; of one that is not, where it is, "module:class", by
    which ``load`` finds it as well. Imports nothing. Raises ConfigError for a class inside of a function."""
    slot = slot_of(config)
    for sharing in _candidates(slot.group, BUILTIN[slot.name]).values():
        for candidate in sharing:
            if candidate.is_loaded_as(type(config)):
                return candidate.name
    kind = type(config)
    if "<locals>" in kind.__qualname__:
        raise ConfigError(
            f"{kind.__module__}.{kind.__qualname__} is not registered as a {slot.one}, and cannot be found by its "
            f"place. Write it outside of the function, or add it to the entry points {slot.group!r} of a package."
        )
    return f"{kind.__module__}:{kind.__qualname__}"


def method_names() -> tuple[str, ...]:
    """Names of all methods, in the order of ``names``."""
    return tuple(_candidates(METHOD_GROUP, METHODS))


def load_method(name: str) -> Callable[[], MethodConfig]:
    """The function that makes the method's config. Raises what ``load`` raises."""
    candidate = _choose(_candidates(METHOD_GROUP, METHODS), name, "method")
    found = candidate.load("method")
    if not callable(found):
        raise ComponentImportError(
            f"method {name!r} of package {candidate.package!r}: {candidate.value!r} is not a function."
        )
    return cast(Callable[[], MethodConfig], found)


def spelled(name: str, known: Iterable[str]) -> str | None:
    """The known name meant by ``name``: itself, or the one in kebab-case where it is written with underscores."""
    known = tuple(known)
    for form in (name, name.replace("_", "-")):
        if form in known:
            return form
    return None


def closest(name: str, known: Iterable[str]) -> str | None:
    """The known name that ``name`` is most likely a slip of, if any is close."""
    return next(iter(difflib.get_close_matches(name, tuple(known), n=1, cutoff=0.6)), None)


def _load(place: Slot, table: Mapping[str, str], name: str) -> type[ComponentConfig]:
    module, by_place, _ = name.partition(":")
    if by_place and module not in sys.modules:
        # A name may come from a file, and files run no code.
        raise UnknownComponentError(
            f"{place.one} {name!r} goes by its place, and {module!r} is not imported. Import it first, or add the "
            f"{place.one} to the entry points {place.group!r} of a package."
        )
    if by_place:
        candidate = Candidate(name=name, package=module, value=name)
    else:
        candidate = _choose(_candidates(place.group, table), name, place.one)
    found = candidate.load(place.one)
    if not (isinstance(found, type) and issubclass(found, place.base) and is_dataclass(found)):
        raise ComponentImportError(
            f"{place.one} {candidate.name!r} of package {candidate.package!r}: {candidate.value!r} is not a dataclass "
            f"derived from {place.base.__name__}."
        )
    try:
        get_type_hints(found)
    except NameError as error:
        raise ComponentImportError(
            f"{place.one} {candidate.name!r} of package {candidate.package!r}: the type of a field of {found.__name__} "
            f"is not there at run time ({error}). Import it outside of TYPE_CHECKING."
        ) from error
    return found


def _default(place: Slot, table: Mapping[str, str], name: str) -> ComponentConfig:
    kind = _load(place, table, name)
    try:
        return kind()
    except TypeError as error:
        raise ComponentImportError(
            f"{place.one} {name!r}: {kind.__module__}.{kind.__qualname__}() failed ({error}). Every field needs "
            "a default, and build() must be written."
        ) from error


def _choose(candidates: Mapping[str, tuple[Candidate, ...]], name: str, what: str) -> Candidate:
    known = spelled(name, candidates)
    if known is None:
        near = closest(name.replace("_", "-"), candidates)
        hint = f" Did you mean {near!r}?" if near else ""
        raise UnknownComponentError(f"there is no {what} {name!r}.{hint} Available: {', '.join(candidates)}.")
    if len(candidates[known]) > 1:
        packages = " and ".join(repr(candidate.package) for candidate in candidates[known])
        raise ComponentImportError(
            f"{what} {known!r} is offered by packages {packages}. Uninstall one of them, or rename it in one."
        )
    return candidates[known][0]


def _candidates(group: str, table: Mapping[str, str]) -> dict[str, tuple[Candidate, ...]]:
    """What is registered, by name; a name has several candidates where packages collide."""
    found: dict[str, tuple[Candidate, ...]] = {
        name: (Candidate(name=name, package=OWN_PACKAGE, value=value),) for name, value in table.items()
    }
    installed = (candidate for where, candidate in _installed(tuple(sys.path)) if where == group)
    for candidate in sorted(installed, key=lambda candidate: (candidate.name, candidate.package)):
        found[candidate.name] = (*found.get(candidate.name, ()), candidate)
    return found


@functools.lru_cache(maxsize=1)
def _installed(path: tuple[str, ...]) -> tuple[tuple[str, Candidate], ...]:
    """Our entry points on the import path ``path``, each with its group.

    Package by package, and not by ``importlib.metadata.entry_points``: there, one malformed file hides all packages.
    """
    found: dict[tuple[str, str, str], Candidate] = {}
    for distribution in distributions(path=list(path)):
        try:
            ours = [entry for entry in distribution.entry_points if entry.group.startswith(f"{GROUPS}.")]
            package = distribution.metadata["Name"] if ours else ""
        except Exception:  # Not ours to judge: another package's metadata cannot be read.
            continue
        for entry in ours:
            # A package found twice on the path counts once, as in an import: the first one is what is imported.
            key = (entry.group, entry.name, package)
            found.setdefault(key, Candidate(name=entry.name, package=package, value=entry.value))
    return tuple((group, candidate) for (group, _, _), candidate in found.items())
