"""The strangers' missions are scenarios, of all kinds promised, and draws repeat."""

from tests.benchmarks.strangers import BASES, MISSIONS, SEEDS, missions


def test_equal_seeds_draw_equal_missions():
    assert list(missions(3, 7)) == list(missions(3, 7)) != list(missions(3, 8))


def test_missions_are_of_all_kinds():
    drawn = list(missions(MISSIONS, SEEDS[0]))
    told = [" ".join(settings) for _, settings in drawn]
    for kind in ("dji_phantom_2", "dji_matrice_100", "radius=", "hold=", "release=", "cylinder",
                 "sphere", "box", "150.000", "roughness", "exponent", "wind.file", "'free'",
                 "speed_max", "floor", "ceiling"):  # fmt: skip
        assert any(kind in settings for settings in told), kind
    assert {base for base, _ in drawn} == {"library.toml", "own.toml"}
    assert all((BASES / base).is_file() for base, _ in drawn)
