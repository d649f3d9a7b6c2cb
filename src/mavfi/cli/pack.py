"""`mavfi campaign pack | unpack`: a campaign as one file, for other users to verify and resume."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import check_file, console, write_json

if TYPE_CHECKING:
    from mavfi.campaign.pack import Manifest

ENDINGS = (".zip",)


def pack(
    directory: options.Ledger,
    out: Annotated[Path | None, typer.Option(metavar="FILE.zip", help="DIR.zip by default.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Write a campaign, complete or not, to one file: ledger, trained models, versions, checksums.

    The campaign may be running.  Equal ledgers give equal bytes.

    Example: [bold]mavfi campaign pack out/states --out states.zip[/bold]
    """
    from mavfi.campaign.pack import pack as pack_campaign

    file = out or directory.absolute().with_name(f"{directory.absolute().name}.zip")
    check_file("--out", file, ENDINGS)
    _tell(pack_campaign(directory, file), str(file), as_json)


def unpack(
    file: Annotated[Path, typer.Argument(metavar="FILE.zip", help="What `mavfi campaign pack` wrote.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the ledger; empty or absent.")],
    as_json: options.AsJson = False,
) -> None:
    """Verify a packed campaign, and unpack it into a folder for reports, verification and resuming.

    Checksums detect damage, not manipulation: `mavfi campaign verify` replays a sample of the runs.

    Example: [bold]mavfi campaign unpack states.zip --out out/states[/bold]
    """
    from mavfi.campaign.fingerprint import versions
    from mavfi.campaign.pack import CONFIG
    from mavfi.campaign.pack import unpack as unpack_campaign

    manifest = unpack_campaign(file, out)
    _tell(manifest, str(out), as_json)
    differing = [name for name, here in versions().items() if manifest.versions.get(name) != here]
    if as_json or manifest.complete:
        return
    if differing:
        name = differing[0]
        text = f"It was begun with {name} {manifest.versions.get(name)}; with other versions it cannot be resumed."
        console(error=True).print(text, soft_wrap=True)
        return
    console().print(f"Resume: [bold]mavfi campaign run {out / CONFIG} --out {out}[/bold]", soft_wrap=True)


def _tell(manifest: "Manifest", where: str, as_json: bool) -> None:
    if as_json:
        write_json({**manifest.model_dump(mode="json"), "file": where})
        return
    models = len(manifest.members) - 1
    text = (
        f"{where}: campaign {manifest.name}, {manifest.done} of {manifest.total} runs"
        f"{', complete' if manifest.complete else ''}, {models} trained models, digest {manifest.digest}"
    )
    console().print(text, markup=False, soft_wrap=True)
