"""`companion campaign report`: what a campaign came to."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion.sources.files import writing


def report_command(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="The folder of a campaign, ended or not.")
    ],
    by: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FACTOR",
            help="Group by this factor; may be repeated, for groups by several together. "
            "By default by each that varies.",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Page to write; by default FOLDER/report.html."),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write all figures to FILE, and all rows beside it, to NAME-rows.csv.",
        ),
    ] = None,
) -> None:
    """Say what a campaign came to: rates, costs, comparisons in pairs, the worst runs.

    Groups are compared with the first of the campaign, in runs of the same world and seed. The
    page is one file that opens without a network, and prints.
    """
    from companion.campaign import report as campaign  # slow to import

    console = Console(soft_wrap=True)
    with Console(stderr=True).status("reading the campaign"):
        report = campaign.report_of(campaign.read_campaign(folder), by or ())
        files = {"--html": {html or folder / "report.html": campaign.report_html(report)}}
        if csv is not None:
            rows = csv.with_name(f"{csv.stem}-rows.csv")
            files["--csv"] = {
                csv: campaign.summary_csv(report),
                rows: campaign.rows_csv(report.campaign.rows),
            }
    for table in campaign.terminal_tables(report):
        console.print(table)
    for line in campaign.report_lines(report):
        console.out(line, highlight=False)
    for option, texts in files.items():
        for path, text in texts.items():
            with writing(option, path):
                path.write_text(text, encoding="utf-8")
            console.out(f"written: {path}", highlight=False)
