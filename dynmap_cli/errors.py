"""What an operator can act on: one line each, with an exit code of its own.

A message says where, what was found, what is allowed and what to do next. Anything that is not a
`DynmapError` is a bug and keeps its traceback (exit code 1). Code 2 is click's own, for usage.
"""


class DynmapError(Exception):
    """A failure that the operator can mend."""

    exit_code = 1


class ConfigError(DynmapError):
    """A setting, scenario or option value that is not allowed, or a sub-map or state that the run does not have."""

    exit_code = 3


class LogError(DynmapError):
    """A recording that cannot be read or used."""

    exit_code = 4


class ArtifactError(DynmapError):
    """A file between stages that is missing, stale, of another version or cannot be written."""

    exit_code = 5
