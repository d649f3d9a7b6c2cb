"""`mavfi watch`: a detector on recorded flights of any vehicle."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from mavfi.cli import options
from mavfi.cli.console import (
    PICTURES,
    check_file,
    check_name,
    check_number,
    check_seed,
    console,
    titled_table,
    write_json,
)
from mavfi.cli.panels import OUTPUT
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.extras.logs.live import LiveView
    from mavfi.extras.logs.recording import LogRecording
    from mavfi.extras.logs.selection import Wanted
    from mavfi.extras.logs.tlog import Telemetry
    from mavfi.extras.logs.watch import JudgedLog, LogRates, LogWatch

HELP_PANEL = "Detectors"
_MAX_FLIPS = 100_000
_MAX_LISTED = 10
_MAX_PORT = 65_535


class LiveOption:
    """The option of `mavfi fly` that serves the running flight to viewers; see the entry points `mavfi.observers`."""

    options = {
        "live": Annotated[
            bool | None,
            typer.Option("--live", help="Serve the running flight to Foxglove and Lichtblick.", rich_help_panel=OUTPUT),
        ]
    }

    @staticmethod
    def chosen(values: dict[str, Any]) -> bool:
        """Whether the option is set."""
        return bool(values["live"])

    @staticmethod
    def build(values: dict[str, Any]) -> tuple[LiveView, str]:
        """The observer, and a line of text that says where the flight can be seen."""
        del values
        from mavfi.extras.logs.live import PORT, LiveView

        view = LiveView(PORT)
        return view, f"serving the flight at {view.address}"


class GroundStationOption:
    """The option of `mavfi fly` that sends the running flight to a ground station; see `mavfi.observers`."""

    options = {
        "mavlink": Annotated[
            int | None,
            typer.Option(
                metavar="PORT",
                help="Send the flight to a ground station's UDP port on loopback, 14550.",
                rich_help_panel=OUTPUT,
            ),
        ]
    }

    @staticmethod
    def chosen(values: dict[str, Any]) -> bool:
        """Whether the option is set; raises `BadInputError` for a value that is not allowed."""
        check_number("--mavlink", values["mavlink"], 1, _MAX_PORT)
        return values["mavlink"] is not None

    @staticmethod
    def build(values: dict[str, Any]) -> tuple[Telemetry, str]:
        """The observer, and a line of text that says where the flight can be seen."""
        from mavfi.extras.logs.tlog import HOST, Telemetry

        port = values["mavlink"]
        return Telemetry(port), f"sending the flight to udp://{HOST}:{port}"


def watch(  # noqa: PLR0913 - one parameter per option
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Recorded flights: .ulg .tlog .bin .bag .mcap .csv, folders")
    ],
    train: Annotated[
        list[Path] | None, typer.Option(metavar="LOG", help="A recorded flight that is normal; may be repeated.")
    ] = None,
    split: Annotated[
        float | None, typer.Option(help="Instead of --train: train on this first share of each LOG, judge the rest.")
    ] = None,
    detector: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="gaussian, autoencoder, recommended, limits, ..., or package:Class.",
            autocompletion=options.complete_detector,
        ),
    ] = "gaussian",
    profile: options.WatchProfile = "tuned",
    fields: Annotated[
        str, typer.Option(metavar="FIELD,...", help="Numbers, e.g. ATTITUDE:roll; recommended ones or all by default.")
    ] = "",
    kinds: Annotated[
        str,
        typer.Option(
            metavar="FIELD=KIND,...",
            help="What fields are, where this is not recognised: rad, deg, cdeg, degE7, quaternion, or number.",
        ),
    ] = "",
    mapping: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            help="For rules and custom detectors: which fields are which quantities; px4, mavlink, ardupilot, mavros, "
            "nav2, mavfi, or a .yaml file; what fits best by default.",
        ),
    ] = "",
    fault: Annotated[
        str, typer.Option(metavar="TOPIC:FIELD", help="A number in LOG that is 0 until a known fault begins.")
    ] = "",
    inject: Annotated[int, typer.Option(help="Bits to flip in each LOG, one at a time.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of these flips.")] = 0,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the fields that raised alarms, over time.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Judge recorded flights with a detector, trained on others.

    Reports false alarms per hour, the share of injected flips that are detected, and the delay of known faults.
    A LOG must not be among those of --train.

    Example: [bold]mavfi watch flight.ulg --train normal1.ulg --train normal2.ulg --inject 300[/bold]
    """
    from mavfi.detectors.preprocess import PROFILES
    from mavfi.extras.logs.detectors import is_fitted, uses_rules
    from mavfi.extras.logs.selection import Wanted, parse_kinds, summary
    from mavfi.extras.logs.watch import LogRates
    from mavfi.extras.shared.log_readers import recording_at

    # Check the options.
    logs = [recording_at(path) for path in logs]
    train = [recording_at(path) for path in train or []]
    is_of_fields = is_fitted(detector)
    if mapping and is_of_fields:
        raise BadInputError(
            f"--mapping: {mapping}: is not read by {detector}; allowed: with rules or a custom detector"
        )
    check_name("--profile", profile, PROFILES)
    check_number("--split", split, 0.05, 0.95)
    check_number("--inject", inject, 0, _MAX_FLIPS)
    check_seed("--seed", seed)
    check_file("--picture", picture, PICTURES)
    if (split is None) == (not train):
        for path in logs:
            if not path.exists():
                raise BadInputError(f"{path}: no such file")
        reason = "both given"
        if split is None:
            reason = "neither given"
        raise BadInputError(f"--train, --split: {reason}; allowed: one of them, what a normal flight is learned from")
    _check_apart(logs, train)
    # Train and judge.
    with stoppable("Stopped."):
        wanted = Wanted(options.listed(fields), parse_kinds(options.listed(kinds)))
        if not is_of_fields:
            wanted = wanted._replace(mapping=mapping, only_mapped=uses_rules(detector))
        trained, recordings, judged = _judge(logs, train, split, (detector, profile), wanted, fault, (inject, seed))
    # What was found, and how.
    rates = LogRates(judged)
    different = list({id(log_watch): log_watch for log_watch in trained}.values())
    trained_on = sum(log_watch.trained_on for log_watch in different)
    names, geometry = _selected(different)
    not_monitored = list(dict.fromkeys(item for log_watch in different for item in log_watch.selection.not_monitored))
    not_monitored += [item for recording in judged for item in recording.not_monitored]
    if picture is not None:
        from mavfi.extras.logs.picture import draw_alarms

        draw_alarms(picture, trained, recordings, judged)
    if as_json:
        write_json(
            rates.to_json()
            | {
                "detector": detector,
                "profile": profile,
                "fields": names,
                "angles_and_quaternions": geometry,
                "not_monitored": [item._asdict() for item in not_monitored],
                "mapping": _mapping_json(trained[0]),
                "trained_on": trained_on,
            }
        )
        return
    how = f"{detector} ({profile}), trained on {trained_on} messages"
    mapped = trained[0].selection.mapping
    if mapped.name:
        how += f"; mapping {mapped.name}: {', '.join(mapped.states) or 'no state'}"
    out = console()
    out.print(rates.headline(), style="bold", markup=False)
    detection = _summary(rates, has_flips=inject > 0)
    for line in [*_events(judged), *detection, *_monitored(names), *summary(not_monitored), how]:
        out.print(line, markup=False, soft_wrap=not out.is_terminal)
    out.print(_table(judged))


def _selected(log_watches: list[LogWatch]) -> tuple[dict[str, list[str]], dict[str, str]]:
    """Monitored fields by topic, and what the angles and quaternions among them are."""
    from mavfi.extras.shared.foreign import TURNS

    names: dict[str, list[str]] = {}
    geometry: dict[str, str] = {}
    for log_watch in log_watches:
        for name, topic in log_watch.selection.topics.items():
            names[name] = topic.names
            for field, kind in topic.kinds.items():
                geometry[f"{name}:{field}"] = kind
                if kind in TURNS:
                    geometry[f"{name}:{field}"] = f"angle ({kind})"
    return names, geometry


def _mapping_json(log_watch: LogWatch) -> dict[str, Any]:
    """Which states of missions were made of which fields."""
    used = log_watch.selection.mapping
    states = {name: {"topic": mapping.topic, **mapping.fields} for name, mapping in used.states.items()}
    return {"name": used.name, "states": states, "counters": list(used.counters), "missing": dict(used.missing)}


def _events(judged: list[JudgedLog]) -> list[str]:
    """What raised alarms in each recording, which topics fell silent, and the first alarm after a known fault.

    Events that follow each other with the same fields are one line.
    """
    lines = []
    for recording in judged:
        runs = [list(run) for _, run in groupby(recording.event_list, lambda event: (event.topics, set(event.fields)))]
        for run in runs[:_MAX_LISTED]:
            line = f"{recording.name} {run[0].text()}"
            if len(run) > 1:
                line += f"; {len(run)} events of these fields, the last at {1e-6 * run[-1].begin_us:.3f} s"
            lines.append(line)
        remaining = sum(map(len, runs[_MAX_LISTED:]))
        if remaining:
            lines.append(f"{recording.name}: {remaining} more events")
        lines += [f"{recording.name} {silence.text()}" for silence in recording.silences[:_MAX_LISTED]]
        if len(recording.silences) > _MAX_LISTED:
            lines.append(f"{recording.name}: {len(recording.silences) - _MAX_LISTED} more silences, see --json")
        alarm = recording.fault_alarm
        if alarm is not None and len(judged) <= _MAX_LISTED:
            fields = ", ".join(alarm.fields)
            lines.append(f"{recording.name}, known fault: {alarm.topic} {fields}, {alarm.source}")
    return lines


def _monitored(names: dict[str, list[str]]) -> list[str]:
    """How much is monitored, in one line."""
    from mavfi.extras.logs.selection import shortened

    count = sum(map(len, names.values()))
    noun = "fields"
    if count == 1:
        noun = "field"
    return [shortened(f"monitored, {count} {noun} of ", list(names))]


def _check_apart(logs: list[Path], train: list[Path]) -> None:
    """Refuse a log that is judged by a detector trained on it, also as a copy under another name."""
    from filecmp import cmp

    for log in logs:
        for path in train:
            if not (log.exists() and path.exists()):
                continue
            is_copy = log.is_file() and path.is_file() and cmp(log, path, shallow=False)
            if is_copy or log.samefile(path):
                copy = ""
                if log != path:
                    copy = f" (it is {path})"
                raise BadInputError(
                    f"{log}: is also trained on{copy}: a detector has no false alarms on its own training data; "
                    "allowed: other flights for --train, or --split"
                )


def _judge(
    logs: list[Path],
    train: list[Path],
    split: float | None,
    detector_and_profile: tuple[str, str],
    wanted: Wanted,
    fault: str,
    flips: tuple[int, int],
) -> tuple[list[LogWatch], list[LogRecording], list[JudgedLog]]:
    """Train and judge; returns the detector of each LOG, the LOG, and what was found in it.

    Each LOG that is split trains its own detector.

    Args:
        logs: The recordings to be judged.
        train: Normal recordings.
        split: Share of each LOG to train on, instead.
        detector_and_profile: Their names.
        wanted: What to monitor.
        fault: Number that tells of a known fault; "" = none.
        flips: Number of flips in each LOG, and their seed.
    """
    from mavfi.extras.logs.recording import read_recording, without_wrapped
    from mavfi.extras.logs.selection import cut_text, select
    from mavfi.extras.logs.watch import LogWatch

    recordings = [read_recording(path, fault) for path in logs]
    normal = [read_recording(path, fault, required=False).normal for path in train]
    notices = [notice for recording in [*recordings, *normal] for notice in recording.notices]
    recordings = _flown(recordings)
    if train:
        normal = _flown(normal)
    # What each detector is trained on: the same recordings, or the first part of the judged one.
    trainings = [normal]
    rests = recordings
    if split is not None:
        halves = [recording.split(split) for recording in recordings]
        trainings = [[first.normal] for first, _ in halves]
        rests = [rest for _, rest in halves]
    for training in trainings:
        for index, recording in enumerate(training):
            training[index], wrapped = without_wrapped(recording)
            notices += wrapped
    for text in [cut_text([*recordings, *normal]), *dict.fromkeys(notices)]:
        if text:
            console(error=True).print(text, markup=False, soft_wrap=True)
    if split is None:
        selection = select(normal, recordings, wanted)
        log_watch = LogWatch(*detector_and_profile, selection, normal, flips[1])
        judged = [log_watch.judge(recording, *flips) for recording in recordings]
        return [log_watch] * len(recordings), recordings, judged
    log_watches = []
    judged = []
    for training, rest in zip(trainings, rests, strict=True):
        log_watch = LogWatch(*detector_and_profile, select(training, [rest], wanted), training, flips[1])
        log_watches.append(log_watch)
        judged.append(log_watch.judge(rest, *flips))
    return log_watches, recordings, judged


def _flown(recordings: list[LogRecording]) -> list[LogRecording]:
    """The recordings with messages: what is left out of the others is a notice."""
    flown = [recording for recording in recordings if recording.messages]
    if not flown:
        reasons = [notice for recording in recordings for notice in recording.notices]
        raise BadInputError("; ".join(reasons) or f"{recordings[0].name}: has no messages")
    return flown


def _summary(rates: LogRates, *, has_flips: bool) -> list[str]:
    """Detection of flips, if they were asked for, and of known faults."""
    from mavfi.extras.logs.selection import shortened
    from mavfi.report.text import rate

    lines = [f"flips detected, {bits} (%): {rate(share)}" for bits, share in rates.flips.items()]
    if has_flips and not lines:
        lines.append("no bit flipped: only floating-point numbers are, and no monitored field is one")
    if rates.blind:
        lines.append(shortened("no flipped sign or exponent detected in ", rates.blind))
    if rates.faults.n:
        span = ""
        if rates.delays_s:
            span = f", delay {rates.delays_s[0]:.2f} to {rates.delays_s[-1]:.2f} s"
        lines.append(f"known faults followed by an alarm (%): {rate(rates.faults)}{span}")
    return lines


def _table(judged: list[JudgedLog]) -> Table:
    from mavfi.extras.logs.watch import delay_text

    table = titled_table("Recordings")
    table.add_column("recording", justify="left")
    for heading in ("normal flight", "messages", "false alarm events", "known fault"):
        table.add_column(heading, justify="right")
    for recording in judged:
        table.add_row(
            recording.name,
            f"{recording.exposure_s:.1f} s",
            str(recording.messages),
            str(recording.events),
            delay_text(recording),
        )
    return table
