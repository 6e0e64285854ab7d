"""CSV files are equal from run to run and hold no formula."""

import pandas as pd
import pytest

from pyomo_quad.report.tables import neutral_cell, write_table


@pytest.mark.parametrize(
    "text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "  =1", "＝1", '=HYPERLINK("http://x")']
)
def test_formula_becomes_text(text):
    assert neutral_cell(text) == f"'{text}"


@pytest.mark.parametrize("cell", ["adaptive/quintic", "a=b", "", -1.5, True, None])
def test_other_cells_stay(cell):
    assert neutral_cell(cell) == cell


def test_written_table_reads_back(tmp_path):
    frame = pd.DataFrame(
        {
            "flight": ["optimal", "=1+1"],
            "energy_J": [709.652812345678, -1e-300],
            "arrived": [True, False],
        }
    )
    write_table(frame, tmp_path / "table.csv")
    text = (tmp_path / "table.csv").read_bytes().decode()
    assert text.splitlines()[1] == "optimal,709.652812346,True"
    read = pd.read_csv(tmp_path / "table.csv")
    assert list(read["flight"]) == ["optimal", "'=1+1"]
    assert read["energy_J"].to_numpy() == pytest.approx(frame["energy_J"].to_numpy(), rel=1e-11)
    assert "\r" not in text


def test_heading_and_missing_number(tmp_path):
    write_table(
        pd.DataFrame({"=cmd": [1.0, float("nan")], "note": ["-x", None]}), tmp_path / "t.csv"
    )
    assert (tmp_path / "t.csv").read_text() == "'=cmd,note\n1,'-x\n,\n"


def test_columns_and_frames_are_written_as_pandas_would(tmp_path):
    numbers = [1.0, -1e-300, float("nan"), float("inf"), 1 / 3]
    columns = {"x_m": numbers, "n": [1, 2, 3, 4, 5], "kept": [True, False] * 2 + [True]}
    frame = pd.DataFrame(columns | {"note": ["a,b", 'say "so"', "", None, "two\nlines"]})
    for table in (frame, dict(frame)):
        write_table(table, tmp_path / "t.csv")
        expected = frame.to_csv(index=False, float_format="%.12g", lineterminator="\n")
        assert (tmp_path / "t.csv").read_bytes().decode() == expected
