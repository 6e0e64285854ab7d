"""Report of a campaign: the same missions flown in turn, again and again, on each battery charge.

A campaign has one or more battery charges. The flights on a charge end when no further flight is
possible. The report has a table of the flights and a figure of charge and voltage.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.style import INK, SERIES_STYLES, legend_below, panel_grid
from pyomo_quad.study.campaign import Campaign, CampaignColumn
from pyomo_quad.version import __version__

CAMPAIGN_NAME = "campaign.csv"


def write_campaign(
    folder: Path, campaign: Campaign, figures: Figures = Figures.SVG
) -> dict[str, Any]:
    """Write the report of a campaign: table (CSV), `summary.json`, figure and text.

    A battery charge ends if no further flight is possible, or after 1000 flights. `folder` must
    exist and be empty. The result is the content of `summary.json`.
    """
    summary = campaign_summary(campaign)
    table = campaign.table()
    drawing = Drawing(
        "campaign",
        "Charge and voltage over the flights",
        "Above: state of charge at the start (dots) and end (squares) of each flight. Below: "
        "lowest voltage of the pack during each flight. Dashed: limits.",
        partial(draw_campaign, campaign),
    )
    write_study(
        folder,
        "report/campaign.md.j2",
        tables={CAMPAIGN_NAME: table},
        summary=summary,
        drawings=(drawing,) if campaign.flights else (),
        figures=figures,
        campaign=campaign,
        words=campaign_words(campaign),
        rows=table.to_dict("records"),
        column=CampaignColumn,
        CAMPAIGN_NAME=CAMPAIGN_NAME,
    )
    return summary


def campaign_summary(campaign: Campaign) -> dict[str, Any]:
    """Return the results of a campaign as a dictionary for `summary.json`.

    For each battery charge, the dictionary holds the number of flights and the reason why no
    further flight followed.
    """
    plans = [flight.plan for flight in campaign.flights]
    return {
        "missions": [mission.name for mission in campaign.missions],
        "charges": campaign.charges,
        "flights": list(campaign.counts),
        "ended_by": list(campaign.endings),
        "duration_s": sum(plan.duration_s for plan in plans),
        "energy_J": sum(plan.energy for plan in plans),
        "solve_wall_s": [plan.timings.get("solve") for plan in plans],
        "versions": {"pyomo_quad": __version__},
        "scenarios_resolved": [mission.model_dump(mode="json") for mission in campaign.missions],
    }


def campaign_words(campaign: Campaign) -> list[str]:
    """Return one sentence for each battery charge of a campaign of repeated missions.

    The sentence gives number, total time and total energy of the flights, and the reason why no
    further flight followed.
    """
    said = []
    for charge, (count, ending) in enumerate(
        zip(campaign.counts, campaign.endings, strict=True), start=1
    ):
        plans = [flight.plan for flight in campaign.flights if flight.charge == charge]
        minutes = sum(plan.duration_s for plan in plans) / 60.0
        energy_kJ = sum(plan.energy for plan in plans) / 1e3
        said.append(
            f"Charge {charge}: {count} flight{'' if count == 1 else 's'}, {minutes:.1f} minutes "
            f"and {energy_kJ:.1f} kJ. Reason for no further flight: {ending}."
        )
    return said


def draw_campaign(campaign: Campaign) -> Figure:
    """Draw state of charge and lowest pack voltage of each flight of a campaign, in two panels.

    Dashed lines mark limits of the first mission: the least permitted state of charge and, if the
    mission limits the voltage, the least permitted pack voltage.
    """
    figure, panels = panel_grid(2, 1, panel_height=1.7, left=0.6, legend_entries=campaign.charges)
    charge_panel, voltage_panel = panels[:, 0]
    table, limits = campaign.table(), campaign.missions[0].limits
    number = np.arange(1, len(table) + 1)
    for charge in range(1, campaign.charges + 1):
        own = (table[CampaignColumn.CHARGE] == charge).to_numpy()
        style = SERIES_STYLES[(charge - 1) % len(SERIES_STYLES)]
        for column, marker in (
            (CampaignColumn.CHARGE_AT_START, "o"),
            (CampaignColumn.CHARGE_AT_END, "s"),
        ):
            label = f"charge {charge}" if marker == "o" else None
            charge_panel.plot(
                number[own],
                table[column][own],
                marker=marker,
                markersize=3,
                label=label,
                **style.line,
            )
        lowest = table[CampaignColumn.LOWEST_VOLTAGE][own]
        voltage_panel.plot(number[own], lowest, marker="o", markersize=3, **style.line)
    dashed: dict[str, Any] = {"color": INK, "linewidth": 1.0, "linestyle": (0, (4, 2))}
    charge_panel.axhline(100.0 * limits.least_charge, **dashed)
    if limits.battery_voltage_min is not None:
        voltage_panel.axhline(limits.battery_voltage_min, **dashed)
    charge_panel.set(title="State of charge (%)", ylim=(0.0, 102.0))
    voltage_panel.set(title="Lowest voltage of the pack (V)", xlabel="Flight")
    voltage_panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend_below(figure, charge_panel)
    return figure
