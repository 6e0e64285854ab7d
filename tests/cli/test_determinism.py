"""The same input gives the same bytes on one machine; only summary.json knows the time."""

from tests.command import solve

TEXTS = (".csv", ".md", ".html", ".svg")


def test_two_runs_write_the_same_tables_and_documents(tmp_path, calm):
    again = solve(tmp_path / "report", "--quiet")
    names = sorted(str(file.relative_to(calm.folder)) for file in calm.folder.rglob("*"))
    assert names == sorted(str(file.relative_to(again.folder)) for file in again.folder.rglob("*"))
    texts = [name for name in names if name.endswith(TEXTS)]
    assert {"plan.csv", "report.md", "figures/states.svg"} <= set(texts)
    for name in texts:
        assert again.read(name) == calm.read(name), name
