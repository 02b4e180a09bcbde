"""Which of the lasers of a robot are used, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.frames import FrameTree, Mounting, find_mounting
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawRecording

_FAR_QUANTILE = 0.95
_SAMPLED_SWEEPS = 200
_TIE = 0.95
_SAME_PLACE_M, _SAME_PLACE_RAD = 0.05, np.radians(5.0)
_LEAST_SHARE = 0.5
_NOT_LEVEL_WORDS = ("vertical", "tilt", "ceiling", "cliff")


@dataclass(frozen=True, slots=True)
class LaserView:
    """What is known of a laser before the choice.

    Attributes
    ----------
    laser : RawLaser
    mounting : Mounting or None
        None where neither log nor tf say how it is mounted.
    field_of_view_rad : float
    typical_far_m : float
        Distance which 5 % of its returns exceed.
    delay_s : float
        Median time from stamp to recording.
    """

    laser: RawLaser
    mounting: Mounting | None
    field_of_view_rad: float
    typical_far_m: float
    delay_s: float

    @property
    def score(self) -> float:
        """How much it sees: sweeps x field of view squared x distance.

        A wide sweep counts more than as many narrow ones with the same beams: it alone says how the robot turned.
        """
        return self.laser.n_scans * self.field_of_view_rad**2 * self.typical_far_m

    @property
    def kind(self) -> tuple[float, ...]:
        """What lasers of one make and setting have in common."""
        shape = self.laser.usual_shape
        return (
            shape.n_beams,
            abs(shape.first_bearing_rad),
            abs(shape.increment_rad),
            shape.range_max_m,
            bool((self.laser.beam_interval_s > 0.0).any()),
        )


@dataclass(frozen=True, slots=True)
class LaserChoice:
    """A laser with the verdict on it.

    Attributes
    ----------
    view : LaserView
    used : bool
    why : str
    """

    view: LaserView
    used: bool
    why: str


def view_lasers(recording: RawRecording, tree: FrameTree, base: str) -> list[LaserView]:
    """Look at all lasers of a recording; *base* is the robot frame, "" where there is none."""
    return [_view(laser, tree, base) for _, laser in sorted(recording.lasers.items())]


def _view(laser: RawLaser, tree: FrameTree, base: str) -> LaserView:
    """Look at one laser."""
    if laser.robot_from_sensor is not None:
        mounting: Mounting | None = Mounting(
            laser.robot_from_sensor, is_upside_down=False, is_level=True, moves=False
        )
    else:
        mounting = find_mounting(tree, base, laser.frame, laser.stamps_ns)
    shape = laser.usual_shape
    values = laser.sample(_SAMPLED_SWEEPS)
    values = values[np.isfinite(values) & (values > 0.0) & (values < np.float32(shape.range_max_m))]
    delays_ns = laser.logged_ns - laser.stamps_ns
    laser.give_back()
    return LaserView(
        laser,
        mounting,
        min(abs(shape.increment_rad) * shape.n_beams, 2.0 * np.pi),
        float(np.quantile(values, _FAR_QUANTILE)) if values.size else 0.0,
        float(np.median(delays_ns, overwrite_input=True)) * 1e-9,
    )


def choose_lasers(name: str, views: list[LaserView], wish: str | None) -> list[LaserChoice]:
    """Take the laser that sees most, and fixed ones of the same kind that sit elsewhere on the robot.

    A laser that swings or is not level is left out, for its sweeps are not of one plane; where nothing says how it is
    mounted, its name tells. Of topics that are
    processed copies of each other (same mounting, same kind) the one recorded soonest after its stamp is the
    driver's own.

    Parameters
    ----------
    name : str
        The recording, for messages.
    views : list of LaserView
    wish : str or None
        The topic to use, whatever the evidence.
    """
    if wish is not None:
        if wish not in {view.laser.name for view in views}:
            found = ", ".join(view.laser.name for view in views)
            msg = (
                f"{name}: no laser scans on '{wish}'; laser topics here: {found}. "
                "Pass one of these with --scan-topic."
            )
            raise LogError(msg)
        return [
            LaserChoice(
                view, view.laser.name == wish, "as set" if view.laser.name == wish else "not asked for"
            )
            for view in views
        ]
    steady = [view for view in views if not _fault(view)]
    pool = steady or views
    most = max(view.score for view in pool)
    best = min(
        (view for view in pool if view.score >= _TIE * most), key=lambda view: (view.delay_s, view.laser.name)
    )
    choices = [_verdict(view, best) for view in views]
    return _without_copies(choices)


def _fault(view: LaserView) -> str:
    """Why a laser does not sweep one horizontal plane; "" where it does."""
    if view.mounting is not None and view.mounting.moves:
        return "it swings or tilts on the robot"
    if view.mounting is not None and not view.mounting.is_level:
        return "it is mounted more than 10 deg out of level"
    named = f"{view.laser.name} {view.laser.frame}".lower()
    if view.mounting is None and any(word in named for word in _NOT_LEVEL_WORDS):
        return "by its name it does not sweep a level plane, and the recording does not say how it is mounted"
    return ""


def _verdict(view: LaserView, best: LaserView) -> LaserChoice:
    """Judge one laser beside the best."""
    if view is best:
        fault = _fault(view)
        return LaserChoice(view, True, f"the only choice, although {fault}" if fault else "sees most")
    fault = _fault(view)
    if fault:
        return LaserChoice(view, False, fault)
    if view.kind != best.kind:
        return LaserChoice(view, False, f"sees less than {best.laser.name} and is of another kind")
    if view.mounting is None or best.mounting is None:
        return LaserChoice(view, False, "its pose on the robot is not known")
    if view.laser.n_scans < _LEAST_SHARE * best.laser.n_scans:
        return LaserChoice(view, False, f"has less than half the scans of {best.laser.name}")
    return LaserChoice(view, True, f"of the same kind as {best.laser.name}, merged")


def _without_copies(choices: list[LaserChoice]) -> list[LaserChoice]:
    """Of lasers at the same place keep the one recorded soonest after its stamp."""
    result: list[LaserChoice] = []
    used = sorted(
        (c for c in choices if c.used),
        key=lambda c: (not c.why.startswith(("sees", "the only")), c.view.delay_s),
    )
    for choice in choices:
        twin = (
            next((c for c in used[: used.index(choice)] if _same_place(c.view, choice.view)), None)
            if choice.used
            else None
        )
        if twin is None:
            result.append(choice)
        else:
            later_s = choice.view.delay_s - twin.view.delay_s
            why = (
                f"a processed copy of {twin.view.laser.name} (same mounting, recorded {later_s:.2f} s later)"
            )
            result.append(LaserChoice(choice.view, False, why))
    return result


def _same_place(a: LaserView, b: LaserView) -> bool:
    """Whether two lasers have the same mounting."""
    if a.mounting is None or b.mounting is None:
        return a.laser.frame == b.laser.frame
    return is_same_place(a.mounting, b.mounting)


def is_same_place(a: Mounting, b: Mounting) -> bool:
    """Whether two mountings are one, within 5 cm and 5 deg."""
    gap = np.abs(a.robot_from_sensor - b.robot_from_sensor)
    turn = abs(float(np.angle(np.exp(1j * gap[2]))))
    return bool(np.hypot(gap[0], gap[1]) < _SAME_PLACE_M and turn < _SAME_PLACE_RAD)
