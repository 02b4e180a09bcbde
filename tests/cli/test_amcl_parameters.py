"""Parameter files of AMCL, as robots have them."""

import pytest
import yaml

from dynmap_cli.config import load_config
from dynmap_cli.errors import ConfigError
from dynmap_cli.localization.amcl_names import NOT_TAKEN, TAKEN
from dynmap_cli.localization.settings import LocalizationSettings
from tests.cli.conftest import run_dynmap

NAV2 = """
amcl:
  ros__parameters:
    {use_sim_time: True, alpha1: 0.2, alpha2: 0.2, alpha3: 0.2, alpha4: 0.2, alpha5: 0.2,
     base_frame_id: "base_footprint", global_frame_id: "map", odom_frame_id: "odom", scan_topic: scan,
     beam_skip_distance: 0.5, beam_skip_error_threshold: 0.9, beam_skip_threshold: 0.3, do_beamskip: false,
     lambda_short: 0.1, laser_likelihood_max_dist: 2.0, laser_max_range: 100.0, laser_min_range: -1.0,
     laser_model_type: "likelihood_field", max_beams: 60, max_particles: 2000, min_particles: 500,
     pf_err: 0.05, pf_z: 0.99, recovery_alpha_fast: 0.0, recovery_alpha_slow: 0.0, resample_interval: 1,
     robot_model_type: "nav2_amcl::DifferentialMotionModel", save_pose_rate: 0.5, sigma_hit: 0.2,
     tf_broadcast: true, transform_tolerance: 1.0, update_min_a: 0.2, update_min_d: 0.25,
     z_hit: 0.5, z_max: 0.05, z_rand: 0.5, z_short: 0.05}
bt_navigator:
  ros__parameters: {use_sim_time: True, global_frame: map, plugin_lib_names: [nav2_spin_action_bt_node]}
local_costmap:
  local_costmap:
    ros__parameters: {rolling_window: true, width: 3, plugins: ["voxel_layer", "inflation_layer"]}
map_server:
  ros__parameters: {yaml_filename: "turtlebot3_world.yaml"}
"""
ROS_1 = """
odom_model_type: diff
odom_alpha1: 0.3
odom_alpha5: 0.1
laser_max_beams: 30
min_particles: 400
max_particles: 5000
kld_err: 0.04
kld_z: 0.9
laser_z_hit: 0.6
laser_z_short: 0.05
laser_sigma_hit: 0.15
laser_max_range: -1.0
laser_model_type: beam
gui_publish_rate: 10.0
"""
WRAPS = (
    "robot1: {{amcl: {{ros__parameters: {{{}}}}}}}",
    "robot1/amcl: {{ros__parameters: {{{}}}}}",
    "/robot1/amcl: {{ros__parameters: {{{}}}}}",
    "/fleet/robot1/amcl: {{ros__parameters: {{{}}}}}\n/**: {{ros__parameters: {{use_sim_time: true}}}}",
    "/fleet: {{robot1/amcl: {{ros__parameters: {{{}}}}}}}",
    "/**/amcl: {{ros__parameters: {{{}}}}}",
    "/**: {{ros__parameters: {{{}}}}}",
)


def written(tmp_path, text):
    path = tmp_path / "params.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_parameter_file_of_nav2_is_read_as_it_is(tmp_path):
    path = written(tmp_path, NAV2)
    loaded = load_config(path, {})
    parameters = yaml.safe_load(NAV2)["amcl"]["ros__parameters"]
    changed = {TAKEN[name]: value for name, value in parameters.items() if name in TAKEN}
    assert len(changed) == 17
    assert loaded.config.localization == LocalizationSettings(**changed)
    said = " ".join(loaded.notes)
    for name in parameters:
        assert name in TAKEN or (name in NOT_TAKEN and f" {name}," in said.replace(":", ","))
    assert all(line.startswith(f"{path}: not used: ") and ", because " in line for line in loaded.notes)


@pytest.mark.parametrize("wrap", ["{}", "amcl: {{{}}}", *WRAPS])
def test_names_of_ros_1_stand_alone_or_below_amcl_or_a_namespace(tmp_path, wrap):
    text = ROS_1 if wrap == "{}" else wrap.format(", ".join(ROS_1.split("\n")[1:-1]))
    settings = load_config(written(tmp_path, text), {}).config.localization
    expected = {
        "alpha1": 0.3, "max_beams": 30, "min_particles": 400, "max_particles": 5000, "pf_err": 0.04, "pf_z": 0.9,
        "z_hit": 0.6, "sigma_hit": 0.15, "sensor": "beam",
    }  # fmt: skip
    assert settings == LocalizationSettings(**expected)


def test_amcl_names_stand_among_own_settings_and_on_the_command_line(tmp_path):
    path = written(
        tmp_path, "localization: {kld_err: 0.1, laser_model_type: likelihood_field_prob, view_m: 5}\n"
    )
    loaded = load_config(path, {"localization.odom_alpha4": 0.5, "localization.z_short": 0.1})
    settings = loaded.config.localization
    assert (settings.pf_err, settings.alpha4, settings.view_m, settings.sensor) == (
        0.1,
        0.5,
        5,
        "likelihood_field",
    )
    assert [line.split(",")[0] for line in loaded.notes] == ["command line: not used: z_short"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("amcl: {ros__parameters: {laser_model_type: sonar}}", "laser_model_type 'sonar' is none of"),
        ("amcl: {kld_err: 0.1, pf_err: 0.2}", "'kld_err' and 'pf_err' are the same parameter"),
        ("localization: {kld_err: 0.1, pf_err: 0.2}", "given twice"),
        ("amcl: {ros__parameters: {z_hit: much}}", "localization.z_hit = 'much' is not allowed"),
        ("localization: {kld_error: 0.1}", "unknown setting"),
        (
            "a/amcl: {ros__parameters: {z_hit: 0.5}}\n/b: {amcl: {ros__parameters: {z_hit: 0.4}}}",
            "params.yaml: 2 nodes of AMCL: a/amcl, /b/amcl; keep that of one robot",
        ),
        ("a/amcl: 3", "the node of AMCL, a/amcl, has no 'key: value' parameters but '3'"),
        ("amlc: {z_hit: 0.5}", r"params.yaml: unknown setting"),
        ("amlc: {ros__parameters: {z_hit: 0.5}}", "without a node of AMCL, it has amlc; give the file"),
        ("robot: {map_server: {ros__parameters: {x: 1}}}", "without a node of AMCL, it has robot"),
        (
            "amcl: {ros__parameters: {laser_max_range: true}}",
            "laser_max_range = true is not allowed: true and false",
        ),
    ],
)
def test_what_has_no_meaning_is_refused_in_one_line(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        load_config(written(tmp_path, text), {})


def test_no_name_is_both_taken_and_left_out():
    assert TAKEN.keys() & NOT_TAKEN.keys() == set()
    assert set(TAKEN.values()) <= LocalizationSettings.model_fields.keys()


def test_the_command_line_says_what_is_not_used(tmp_path):
    result = run_dynmap("config", "show", "--config", written(tmp_path, NAV2))
    assert "sigma_hit: 0.2  # from" in result.stdout
    assert "not used: alpha5, robot_model_type, because" in result.stderr
