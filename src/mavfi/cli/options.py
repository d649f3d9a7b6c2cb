"""Options of `mavfi fly`, one type each: type, name and help."""

from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import JSON_HELP

Environment = Annotated[str, typer.Option(help="Name, a YAML file, or a scanned map (.bt, .ot of OctoMap).")]
Seed = Annotated[int, typer.Option(help="All randomness of the mission comes from it.")]
Start = Annotated[
    tuple[float, float, float] | None, typer.Option(metavar="X Y Z", help="m, instead of the environment's.")
]
Goal = Annotated[
    tuple[float, float, float] | None, typer.Option(metavar="X Y Z", help="m, instead of the environment's.")
]
Stack = Annotated[str, typer.Option(help="published, hardened, or a YAML file.")]
Planner = Annotated[str, typer.Option(help="rrt, rrt_connect, rrt_star, a YAML file, or package:Class.")]
Platform = Annotated[str, typer.Option(help="Computer whose latencies are charged: a name, or a YAML file.")]
MapKind = Annotated[
    str, typer.Option("--map", help="Where the map keeps its log-odds: dense, octree, or package:Class.")
]
MapResolution = Annotated[float | None, typer.Option(help="Voxel edge, m; the environment's by default.")]
Vehicle = Annotated[str | None, typer.Option(help="A name, or a YAML file; the environment's by default.")]
VMax = Annotated[float | None, typer.Option(help="Speed limit, m/s; the environment's by default.")]
DepthNoise = Annotated[float, typer.Option(help="Of the depth camera: standard deviation / range.")]
Wind = Annotated[float, typer.Option(help="Amplitude of gusts, m/s.")]
Localization = Annotated[str, typer.Option(help="truth, or estimator (from IMU and position fixes).")]
Fault = Annotated[
    str | None,
    typer.Option(
        metavar="SPEC",
        help=r"null, state:STATE[.FIELD][[ELEMENT]][:bit=N]\[@SECONDS], or instruction:KERNEL[:which=CLASS]"
        r"[:model=MODEL].",
    ),
]
FaultSeed = Annotated[
    int | None,
    typer.Option(help="Draws what the fault does not name: instant, element, instruction, bit; 0 by default."),
]
Detector = Annotated[str, typer.Option(help="gaussian, autoencoder, another entry point, or package:Class.")]
Profile = Annotated[str | None, typer.Option(help="Of the detector: paper (the default) or tuned.")]
Models = Annotated[Path | None, typer.Option(help="Folder of trained models; the shipped ones by default.")]
AsJson = Annotated[bool, typer.Option("--json", help=JSON_HELP)]
Save = Annotated[Path | None, typer.Option(metavar="FILE.npz", help="Write the whole record of the flight.")]
Picture = Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the flight from above and from the side.")]
