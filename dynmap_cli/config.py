"""Settings: defaults < file < command line, checked once, frozen. Nothing is repaired in silence."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dynmap_cli.clustering.settings import ClusteringSettings
from dynmap_cli.errors import ConfigError
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.plain_values import said
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.localization.amcl_names import amcl_parameters, is_amcl_name, translate
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.mapping.settings import MapSettings
from dynmap_cli.segmentation.settings import SegmentationSettings

AMCL = "amcl"
"""The section under which parameters of a file of AMCL go until they are translated."""

_COMMAND_LINE = "command line"


class Config(BaseModel):
    """All settings, one section per room."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int = Field(0, ge=0, lt=2**63, description="Seed of everything random.")
    ingest: IngestSettings = IngestSettings()
    map: MapSettings = MapSettings()
    segmentation: SegmentationSettings = SegmentationSettings()
    clustering: ClusteringSettings = ClusteringSettings()
    localization: LocalizationSettings = LocalizationSettings()


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """Settings with where each that is not a default came from.

    Attributes
    ----------
    config : Config
    origins : dict of str to str
        "section.key" -> file name or "command line".
    notes : tuple of str
        Parameters of AMCL that were given and are not used, with the reason.
    """

    config: Config
    origins: dict[str, str]
    notes: tuple[str, ...] = ()


def load_config(path: Path | None, assignments: Mapping[str, Any]) -> LoadedConfig:
    """Read the settings in effect.

    Parameters
    ----------
    path : Path or None
        YAML file: sections of settings, or a parameter file of nav2 or of AMCL as it is.
    assignments : mapping of "section.key" to value
        From the command line.

    Raises
    ------
    ConfigError
        On an unknown key (with the nearest known one) or a value out of bounds.
    """
    given = [] if path is None else [(str(path), _flat(_read_yaml(path), path))]
    return config_of([*given, (_COMMAND_LINE, assignments)])


def config_of(given: Sequence[tuple[str, Mapping[str, Any]]]) -> LoadedConfig:
    """The settings in effect.

    Parameters
    ----------
    given : sequence of (str, mapping of "section.key" to value)
        Where settings come from, and which; later ones win.

    Raises
    ------
    ConfigError
        On an unknown key (with the nearest known one) or a value out of bounds, with where it came from.
    """
    values: dict[str, Any] = {}
    origins: dict[str, str] = {}
    notes: list[str] = []
    for origin, assigned in given:
        translated, unused = _without_amcl_names(assigned, origin)
        notes += unused
        for key, value in translated.items():
            _assign(values, key, value, "" if origin == _COMMAND_LINE else f"{origin}: ")
            origins[key] = origin
    try:
        return LoadedConfig(Config.model_validate(values), origins, tuple(notes))
    except ValidationError as err:
        raise ConfigError(_explain(err, origins)) from err


def parse_assignments(words: Sequence[str]) -> dict[str, Any]:
    """Turn `section.key=value` words into a mapping; values are read as YAML."""
    assignments: dict[str, Any] = {}
    for word in words:
        key, sign, value = word.partition("=")
        if not sign or not key:
            msg = f"--set {word}: expected section.key=value, for instance map.resolution_m=0.1"
            raise ConfigError(msg)
        try:
            assignments[key.strip()] = parse_yaml(value)
        except ValueError as err:
            msg = f"--set {word[:80]}: the value cannot be read ({reason(err)})"
            raise ConfigError(msg) from err
    return assignments


def known_keys() -> dict[str, str]:
    """Every "section.key" with its one line of description."""
    keys: dict[str, str] = {}
    for name, field in Config.model_fields.items():
        if isinstance(field.default, BaseModel):
            inner = type(field.default).model_fields
            keys.update({f"{name}.{key}": value.description or "" for key, value in inner.items()})
        else:
            keys[name] = field.description or ""
    return keys


def _read_yaml(path: Path) -> dict[str, Any]:
    """Read a settings file as a mapping."""
    try:
        content = parse_yaml(read_text(path))
    except (OSError, ValueError) as err:
        msg = f"{path}: settings cannot be read ({reason(err)})"
        raise ConfigError(msg) from err
    if content is None:
        return {}
    if not isinstance(content, dict):
        msg = f"{path}: expected sections of 'key: value', found {type(content).__name__}"
        raise ConfigError(msg)
    return content


def _flat(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Turn sections into "section.key" entries; a parameter file of AMCL is the section `localization`."""
    flat: dict[str, Any] = {}
    try:
        parameters = None if content.keys() & Config.model_fields.keys() else amcl_parameters(content)
    except ValueError as err:
        msg = f"{path}: {err}"
        raise ConfigError(msg) from err
    if parameters is not None:
        return {f"{AMCL}.{name}": value for name, value in parameters.items()}
    for section, value in content.items():
        if isinstance(value, dict):
            flat.update({f"{section}.{key}": inner for key, inner in value.items()})
        elif value is None and section in Config.model_fields and section != "seed":
            continue
        elif section in Config.model_fields and section != "seed":
            msg = f"{path}: '{section}' is a section of 'key: value' lines, found {_short(value)}"
            raise ConfigError(msg)
        else:
            flat[str(section)] = value
    return flat


def _without_amcl_names(assigned: Mapping[str, Any], origin: str) -> tuple[dict[str, Any], list[str]]:
    """Give settings that go by AMCL's name their own; return them and what AMCL has and dynmap has not."""
    own: dict[str, Any] = {}
    foreign: dict[str, Any] = {}
    for key, value in assigned.items():
        section, _, name = key.partition(".")
        if section == AMCL or (section == "localization" and key not in known_keys() and is_amcl_name(name)):
            foreign[name] = value
        else:
            own[key] = value
    try:
        settings, unused = translate(foreign)
    except ValueError as err:
        msg = f"{origin}: {err}"
        raise ConfigError(msg) from err
    for name, value in settings.items():
        if f"localization.{name}" in own:
            msg = f"{origin}: 'localization.{name}' is given twice, once by AMCL's name for it; leave one out"
            raise ConfigError(msg)
        own[f"localization.{name}"] = value
    return own, [f"{origin}: {line}" for line in unused]


def _assign(values: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Set one dotted key after checking that it exists, and that no yes or no stands where a number is meant."""
    known = known_keys()
    if key not in known:
        names = difflib.get_close_matches(key[:80], known, n=1, cutoff=0.5)
        hint = f", did you mean '{names[0]}'?" if names else ""
        section, dot, last = key.partition(".")
        if names and dot and names[0].startswith(section + "."):
            hint = f" in section '{section}', did you mean '{names[0].partition('.')[2]}'?"
            key = last
        msg = f"{where}unknown setting '{key[:80]}'{hint or '.'} `dynmap config show` lists all"
        raise ConfigError(msg)
    section, dot, last = key.partition(".")
    if _holds_bool(value) and not _takes_bool(section, last):
        msg = f"{where}{key} = {said(value)} is not allowed: true and false are no numbers or words ({known[key]})"
        raise ConfigError(msg)
    if dot:
        values.setdefault(section, {})[last] = value
    else:
        values[key] = value


def _holds_bool(value: object) -> bool:
    """Whether a value is true or false, or a list with one; pydantic would take them for 1 and 0."""
    return isinstance(value, bool) or (isinstance(value, list) and any(map(_holds_bool, value)))


def _takes_bool(section: str, key: str) -> bool:
    """Whether a setting is true or false."""
    field = Config.model_fields[section]
    if isinstance(field.default, BaseModel):
        field = type(field.default).model_fields[key]
    return "bool" in str(field.annotation)


def _explain(err: ValidationError, origins: dict[str, str]) -> str:
    """One line for the first value that is not allowed."""
    first = err.errors()[0]
    key = ".".join(str(part) for part in first["loc"][:2])
    said = first["msg"].removeprefix("Value error, ")
    if key not in known_keys():
        # Two settings that do not go together: it is not the section that is wrong.
        given = [where for name, where in origins.items() if name.startswith(f"{key}.")]
        return f"{given[0] if given else 'settings'}: {key}: {said}; give both so that they go together"
    said = said[0].lower() + said[1:]
    value = _short(first.get("input"))
    return f"{origins.get(key, 'settings')}: {key} = {value} is not allowed: {said} ({known_keys()[key]})"


def _short(value: object) -> str:
    """What was found, in few words."""
    words = repr(value)
    return words if len(words) <= 80 else f"{words[:77]}..."


def as_commented_yaml(loaded: LoadedConfig) -> str:
    """Write all settings as YAML, each with its one line of why and, if it is not a default, its origin."""
    lines: list[str] = []
    described = known_keys()
    for name, value in loaded.config.model_dump(mode="json").items():
        if not isinstance(value, dict):
            lines += _commented(name, name, value, "", described, loaded.origins)
            continue
        lines += ["", f"{name}:"]
        for key, inner in value.items():
            lines += _commented(f"{name}.{key}", key, inner, "  ", described, loaded.origins)
    return "\n".join(lines) + "\n"


def _commented(
    path: str, key: str, value: object, indent: str, described: Mapping[str, str], origins: Mapping[str, str]
) -> list[str]:
    """Return the description as a comment, then `key: value`."""
    text = (
        yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("\n").removesuffix("\n...")
    )
    origin = f"  # from {origins[path]}" if path in origins else ""
    return [f"{indent}# {described[path]}", f"{indent}{key}: {text}{origin}"]
