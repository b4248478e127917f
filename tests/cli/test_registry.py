"""Names, other packages, and what a broken one does."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.errors import ComponentImportError, ConfigError, UnknownComponentError
from sculpt_plugins.builtin import BUILTIN, EXPORTERS, METHODS

FIELD = """
from dataclasses import dataclass
from sculpt_framework.config import FieldConfig

@dataclass(frozen=True, kw_only=True)
class WavesConfig(FieldConfig):
    '''Waves.'''
    waves: int = 3
    '''How many.'''
    def build(self, device): ...
"""
FIELDS = "sculpt_framework.fields"
BUILT_IN = [(slot, name) for slot, table in BUILTIN.items() for name in table]


def test_every_slot_of_the_table_is_known():
    assert set(BUILTIN) == set(registry.SLOTS)


@pytest.mark.parametrize(("slot", "name"), BUILT_IN)
def test_every_built_in_loads_and_knows_its_name(slot: str, name: str):
    assert registry.name_of(registry.default(slot, name)) == name


@pytest.mark.parametrize("name", EXPORTERS)
def test_every_export_format_loads_and_names_its_file(name: str):
    config = registry.default_exporter(name)
    assert config.file_name
    assert inspect.getdoc(type(config))


@pytest.mark.parametrize("name", METHODS)
def test_every_method_makes_a_config_under_its_name(name: str):
    assert registry.load_method(name)().method == name


def test_built_ins_come_first():
    assert registry.names("field")[:3] == ("mlp", "hash-grid", "dense-grid")


def test_a_package_adds_a_field(install):
    install("sculpt-waves", {FIELDS: {"waves": "sculpt_waves:WavesConfig"}}, sculpt_waves=FIELD)
    assert "waves" in registry.names("field")
    assert registry.load("field", "waves")().waves == 3
    assert registry.name_of(registry.default("field", "waves")) == "waves"


def test_a_class_may_be_registered_under_another_module(install):
    modules = {"sculpt_waves": "from sculpt_waves_code import WavesConfig as Exported", "sculpt_waves_code": FIELD}
    install("sculpt-waves", {FIELDS: {"waves": "sculpt_waves:Exported"}}, **modules)
    assert registry.name_of(registry.default("field", "waves")) == "waves"


@pytest.mark.parametrize("name", ["hash_grid", "hash-grid"])
def test_both_spellings_load(name: str):
    assert registry.load("field", name).__name__ == "HashGridFieldConfig"


@pytest.mark.parametrize("given", ["hash-gird", "Hash-Grid", "hashgrid", "hash_gird"])
def test_unknown_names_are_answered_with_the_nearest(given: str):
    with pytest.raises(UnknownComponentError, match=rf"no field '{given}'\. Did you mean 'hash-grid'\?"):
        registry.load("field", given)


def test_a_name_like_no_other_lists_what_there_is():
    with pytest.raises(UnknownComponentError, match=r"no field 'xyzzy'\. Available: mlp, hash-grid, dense-grid\."):
        registry.load("field", "xyzzy")


@pytest.mark.parametrize(
    ("value", "source", "cause"),
    [
        ("sculpt_broken:Config", "import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("sculpt_broken:Config", "def (", "SyntaxError: "),
        ("sculpt_broken:Config", "1 / 0", "ZeroDivisionError: division by zero"),
        ("sculpt_broken:Config", "", "AttributeError: module 'sculpt_broken' has no attribute 'Config'"),
        ("no_such_module:Config", "", "ModuleNotFoundError: No module named 'no_such_module'"),
    ],
)
def test_a_broken_package_disturbs_nothing_until_chosen(install, value: str, source: str, cause: str):
    install("sculpt-broken", {FIELDS: {"broken": value}}, sculpt_broken=source)
    assert "broken" in registry.names("field")
    assert registry.load("field", "mlp").__name__ == "MlpFieldConfig"
    with pytest.raises(ComponentImportError) as caught:
        registry.load("field", "broken")
    text = str(caught.value)
    assert text.startswith(f"field 'broken' of package 'sculpt-broken' cannot be imported from {value!r} ({cause}")
    assert "\n" not in text


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("Config = 3", "is not a dataclass derived from FieldConfig"),
        ("class Config: ...", "is not a dataclass derived from FieldConfig"),
        (FIELD.replace("FieldConfig", "ExtractorConfig") + "Config = WavesConfig", "derived from FieldConfig"),
        (FIELD.replace("int = 3", "int") + "Config = WavesConfig", "Every field needs a default"),
        (FIELD.replace("build", "built") + "Config = WavesConfig", "build"),
        (FIELD.replace("waves: int", "waves: 'Elsewhere'") + "Config = WavesConfig", "Elsewhere"),
    ],
)
def test_what_is_no_config_is_named(install, source: str, said: str):
    install("sculpt-odd", {FIELDS: {"odd": "sculpt_odd:Config"}}, sculpt_odd=source)
    with pytest.raises(ComponentImportError, match="odd") as caught:
        registry.default("field", "odd")
    assert said in str(caught.value)


def test_two_packages_with_one_name_are_both_named(install):
    install("sculpt-a", {FIELDS: {"waves": "sculpt_a:WavesConfig"}}, sculpt_a=FIELD)
    install("sculpt-b", {FIELDS: {"waves": "sculpt_b:WavesConfig"}}, sculpt_b=FIELD)
    assert registry.names("field").count("waves") == 1
    with pytest.raises(ComponentImportError, match="offered by packages 'sculpt-a' and 'sculpt-b'"):
        registry.load("field", "waves")


def test_a_package_cannot_take_the_name_of_a_built_in_unseen(install):
    install("sculpt-a", {FIELDS: {"mlp": "sculpt_a:WavesConfig"}}, sculpt_a=FIELD)
    with pytest.raises(ComponentImportError, match="'gaussian-sculpting' and 'sculpt-a'"):
        registry.load("field", "mlp")


def test_unreadable_metadata_of_one_package_hides_no_other(install):
    folder = install("sculpt-torn", {})
    (folder / "sculpt_torn-1.0.dist-info" / "entry_points.txt").write_text(
        "[sculpt_framework.fields]\nno equals sign", encoding="utf-8"
    )
    install("sculpt-waves", {FIELDS: {"waves": "sculpt_waves:WavesConfig"}}, sculpt_waves=FIELD)
    assert "waves" in registry.names("field")


def test_an_unregistered_config_goes_by_its_place(install):
    install("sculpt-waves", {}, sculpt_waves=FIELD)
    from sculpt_waves import WavesConfig  # pyright: ignore[reportMissingImports]

    assert registry.name_of(WavesConfig()) == "sculpt_waves:WavesConfig"
    assert registry.load("field", "sculpt_waves:WavesConfig") is WavesConfig
    with pytest.raises(UnknownComponentError, match="'nowhere_at_all:Waves' goes by its place, and"):
        registry.load("field", "nowhere_at_all:Waves")
    with pytest.raises(ComponentImportError, match="'sculpt_waves:Nothing' of package 'sculpt_waves' cannot be"):
        registry.load("field", "sculpt_waves:Nothing")
    with pytest.raises(ComponentImportError, match="not a dataclass derived from LossConfig"):
        registry.load("losses", "sculpt_waves:WavesConfig")

    class Inner(WavesConfig):
        pass

    with pytest.raises(ConfigError, match="Inner is not registered as a field, and cannot be found by its place"):
        registry.name_of(Inner())


def test_listing_names_imports_no_plug_in():
    script = (
        "import sys\nfrom sculpt_framework import registry\n"
        "for slot in registry.SLOTS: registry.names(slot)\n"
        "registry.method_names()\n"
        "loaded = sorted(m for m in sys.modules if m.startswith(('sculpt_plugins', 'sculpt_methods')))\n"
        "sys.exit(loaded != ['sculpt_plugins', 'sculpt_plugins.builtin'])"
    )
    assert subprocess.run([sys.executable, "-c", script], timeout=60, check=False).returncode == 0


def test_the_entry_point_groups_are_frozen():
    groups = " ".join(slot.group.removeprefix("sculpt_framework.") for slot in registry.SLOTS.values())
    assert groups == (
        "fields extractors binders appearances rasterizers backgrounds initializers datasets losses constraints "
        "observers"
    )
    assert registry.METHOD_GROUP == "sculpt_framework.methods"


def test_packages_beside_the_run_are_seen(install, tmp_path: Path):
    assert "late" not in registry.names("field")
    install("sculpt-late", {FIELDS: {"late": "sculpt_late:WavesConfig"}}, sculpt_late=FIELD)
    assert "late" in registry.names("field")
