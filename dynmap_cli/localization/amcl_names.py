"""AMCL's parameters, of ROS 2 (nav2_amcl) and ROS 1, as settings of this room: taken, or said why not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TAKEN = {
    **{f"alpha{k}": f"alpha{k}" for k in range(1, 5)},
    "z_hit": "z_hit",
    "z_rand": "z_rand",
    "sigma_hit": "sigma_hit",
    "laser_likelihood_max_dist": "laser_likelihood_max_dist",
    "laser_max_range": "laser_max_range",
    "laser_model_type": "sensor",
    "max_beams": "max_beams",
    "min_particles": "min_particles",
    "max_particles": "max_particles",
    "update_min_d": "update_min_d",
    "update_min_a": "update_min_a",
    "pf_err": "pf_err",
    "pf_z": "pf_z",
}
"""Names of nav2_amcl whose value is a setting here, and of which."""
MODELS = {
    "likelihood_field": "likelihood_field",
    "likelihood_field_prob": "likelihood_field",
    "beam": "beam",
}
"""Values of `laser_model_type`."""
_LEFT_OUT = {
    "a step is turned, driven and turned for any drive; drift_sigma_m is the noise across the way": (
        "alpha5", "robot_model_type", "odom_model_type",
    ),
    "Eq. 1.1 has static_prior for what is not in the map, and beams without return as free ways": (
        "z_short", "z_max", "lambda_short",
    ),
    "an end far from everything weighs z_rand / laser_max_range, so no beam has to be skipped": (
        "do_beamskip", "beam_skip_distance", "beam_skip_threshold", "beam_skip_error_threshold",
    ),
    "particles are drawn anew whenever less than half of them are effective": ("resample_interval",),
    "a robot that is lost is searched for in the whole map": (
        "recovery_alpha_slow", "recovery_alpha_fast",
    ),
    "lasers, their limits and frames are found in the recording; --scan-topic names another": (
        "laser_min_range", "scan_topic", "base_frame_id", "odom_frame_id", "global_frame_id",
    ),
    "it belongs to one drive; --start X,Y,YAW gives it": (
        "set_initial_pose", "always_reset_initial_pose", "initial_pose", "initial_pose_x", "initial_pose_y",
        "initial_pose_a", "initial_cov_xx", "initial_cov_yy", "initial_cov_aa",
    ),
    "the map is named on the command line": ("map_topic", "first_map_only", "use_map_topic"),
    "recordings are read from files and nothing is published": (
        "use_sim_time", "tf_broadcast", "transform_tolerance", "save_pose_rate", "gui_publish_rate",
        "restore_defaults", "bond_disable_heartbeat_timeout", "service_introspection_mode",
        "selective_resampling", "freespace_downsampling", "qos_overrides",
    ),
}  # fmt: skip
NOT_TAKEN = {name: why for why, names in _LEFT_OUT.items() for name in names}
"""Names that have no setting here, with the reason."""
_ROS_1 = {
    **{f"odom_alpha{k}": f"alpha{k}" for k in range(1, 6)},
    **{
        f"laser_{name}": name for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
    },
    "laser_max_beams": "max_beams",
    "kld_err": "pf_err",
    "kld_z": "pf_z",
}
"""Names of ROS 1 that are others in ROS 2."""


def is_amcl_name(name: str) -> bool:
    """Whether AMCL of ROS 1 or ROS 2 has a parameter of this name."""
    return _ROS_1.get(name, name) in TAKEN or _ROS_1.get(name, name) in NOT_TAKEN


_AMCL, _ANY = "amcl", "**"
"""How a parameter file names the node behind its namespace; `**` = any node."""


def amcl_parameters(content: Mapping[str, Any]) -> dict[str, Any] | None:
    """The parameters of AMCL in a parameter file of nav2 or of ROS 1, None if the file is none.

    A nav2 file has `amcl: ros__parameters:`, or `/**:` for any node, in some files below a namespace or with the
    namespace in the name, as `robot1/amcl:`; in ROS 1 the parameters stand below `amcl:` or alone.

    Raises
    ------
    ValueError
        If there are several such nodes, the node has no parameters, or the file is one of other nodes only.
    """
    nodes = _nodes(content, _AMCL) or _nodes(content, _ANY)
    if len(nodes) > 1:
        msg = f"{len(nodes)} nodes of AMCL: {', '.join(nodes)}; keep that of one robot"
        raise ValueError(msg)
    for name, node in nodes.items():
        inner = node.get("ros__parameters", node) if isinstance(node, dict) else node
        if not isinstance(inner, dict):
            msg = f"the node of AMCL, {name}, has no 'key: value' parameters but {str(inner)[:40]!r}"
            raise ValueError(msg)
        return dict(inner)
    if content and all(isinstance(name, str) for name in content) and any(map(is_amcl_name, content)):
        return dict(content)
    others = [str(name) for name, value in content.items() if _has_parameters(value)]
    if others:
        msg = (
            f"a parameter file of nav2 without a node of AMCL, it has {', '.join(others[:5])}; "
            "give the file that has 'amcl: ros__parameters:', or sections of dynmap's settings"
        )
        raise ValueError(msg)
    return None


def _nodes(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The nodes of this name by their full name, at the top and below one namespace."""
    found = {str(key): value for key, value in content.items() if _last(key) == name}
    for space, inner in content.items():
        if str(space) not in found and isinstance(inner, dict):
            found.update({f"{space}/{key}": value for key, value in inner.items() if _last(key) == name})
    return found


def _last(key: object) -> str:
    """The name of a node without its namespace."""
    return str(key).rpartition("/")[2]


def _has_parameters(value: object) -> bool:
    """Whether a value is a node of ROS 2, or holds one below a namespace."""
    return isinstance(value, dict) and (
        "ros__parameters" in value
        or any(isinstance(inner, dict) and "ros__parameters" in inner for inner in value.values())
    )


def translate(parameters: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Turn AMCL's parameters into settings.

    Returns
    -------
    dict of str to Any
        Settings of the section `localization`.
    list of str
        What was not used, one line per reason.

    Raises
    ------
    ValueError
        If two names mean the same setting, or a value has no meaning here.
    """
    settings: dict[str, Any] = {}
    given: dict[str, str] = {}
    left: dict[str, list[str]] = {}
    for name, value in parameters.items():
        modern = _ROS_1.get(name, name)
        if (
            modern == "laser_max_range"
            and isinstance(value, int | float)
            and not isinstance(value, bool)
            and value <= 0
        ):
            left.setdefault("the limit of the recorded laser is used", []).append(name)
        elif modern in TAKEN:
            if modern in given:
                msg = f"'{given[modern]}' and '{name}' are the same parameter; give one of them"
                raise ValueError(msg)
            given[modern] = name
            settings[TAKEN[modern]] = _model(value) if modern == "laser_model_type" else value
        else:
            why = NOT_TAKEN.get(modern, "dynmap knows no such parameter of AMCL")
            left.setdefault(why, []).append(name)
    return settings, [f"not used: {', '.join(names)}, because {why}" for why, names in left.items()]


def _model(value: object) -> str:
    """The sensor model that a value of `laser_model_type` means."""
    if not isinstance(value, str) or value not in MODELS:
        msg = f"laser_model_type {str(value)[:60]!r} is none of {', '.join(MODELS)}"
        raise ValueError(msg)
    return MODELS[value]
