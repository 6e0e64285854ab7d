"""A scenario as one line per field, so that a test can change or add a single line."""

from pathlib import Path

LINES = {
    "name": '"hop"',
    "mission.duration": "5.0",
    "mission.goal.position": "[1.0, 2.0, 3.0]",
}


def write_scenario(folder: Path, *changes: str) -> Path:
    """Write `hop.toml`; each change is a line `field = value` that replaces or joins the others."""
    lines = dict(LINES)
    for change in changes:
        field, _, value = change.partition("=")
        lines[field.strip()] = value.strip()
    file = folder / "hop.toml"
    file.write_text("".join(f"{field} = {value}\n" for field, value in lines.items()))
    return file


def write_wind(folder: Path, times, wind=None) -> Path:
    """Write `wind.csv` with the same wind on both axes."""
    wind = [0.5] * len(times) if wind is None else wind
    rows = [f"{time},{speed},{speed}" for time, speed in zip(times, wind, strict=True)]
    file = folder / "wind.csv"
    file.write_text("\n".join(["time_s,wind_x_m_per_s,wind_y_m_per_s", *rows]))
    return file
