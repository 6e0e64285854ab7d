"""Files below the size limit that make a parser work for minutes, or dig without end."""

import sys
import tempfile
from pathlib import Path

from pyomo_quad.scenario import PyomoQuadError, load_scenario


def hostile_files(size: int) -> dict[str, str]:
    """Return texts of about so many letters by what they are made of."""
    k = size
    return {
        "brackets": "v = " + "[" * k,
        "closed brackets": "v = " + "[" * k + "]" * k,
        "braces": "v = " + "{a=" * (k // 3),
        "table brackets": "[" * k,
        "bracket space": "v = " + "[ " * (k // 2),
        "bracket newline": "v = " + "[\n" * (k // 2),
        "bracket comment": "v = " + "[#\n" * (k // 3),
        "mixed nesting": "v = " + "[{a=" * (k // 4),
        "dashes": "-" * k,
        "dash value": "v = " + "-" * k,
        "dash key": "-" * k + " = 1",
        "underscores": "_" * k,
        "digits": "v = " + "9" * k,
        "under digits": "v = 1" + "_1" * (k // 2),
        "float digits": "v = 1." + "0" * k,
        "exponent": "v = 1e" + "9" * k,
        "hex": "v = 0x" + "f" * k,
        "dates": "v = 1979-05-27T00:00:00." + "0" * k,
        "dots": "." * k,
        "dotted key": "a." * (k // 2) + "a = 1",
        "dotted spaced": "a . " * (k // 4) + "a = 1",
        "dotted header": "[" + "a." * (k // 2) + "a]",
        "quoted dots": "''." * (k // 3) + "'' = 1",
        "dquoted dots": '"".' * (k // 3) + '"" = 1',
        "quotes": '"' * k,
        "single quotes": "'" * k,
        "open string": 'v = "' + "a" * k,
        "escapes": 'v = "' + '\\"' * (k // 2),
        "unicode escapes": 'v = "' + "\\u0041" * (k // 6) + '"',
        "multi string": 'v = """' + "a\n" * (k // 2),
        "multi quotes": 'v = """' + '""\\"' * (k // 4),
        "literal multi": "v = '''" + "''a" * (k // 3),
        "line ends": 'v = """' + "\\\n" * (k // 2) + '"""',
        "newlines": "\n" * k,
        "crlf": "\r\n" * (k // 2),
        "cr": "\r" * k,
        "spaces": " " * k,
        "tabs": "\t" * k + "= 1",
        "comments": "#\n" * (k // 2),
        "long comment": "#" * k,
        "equals": "=" * k,
        "commas": "v = [" + "," * k,
        "long list": "v = [" + "1," * (k // 2) + "]",
        "list of lists": "v = [" + "[]," * (k // 3) + "]",
        "keys": "".join(f"k{i}=1\n" for i in range(k // 9)),
        "tables": "".join(f"[t{i}]\n" for i in range(k // 9)),
        "arrays of tables": "[[a]]\n" * (k // 6),
        "sub tables": "[[a]]\n[a.b]\n" * (k // 12),
        "deep tables": "".join(f"[a.b.c.d.e.f.g.h{i}]\n" for i in range(k // 22)),
        "inline keys": "v = {" + ",".join(f"k{i}=1" for i in range(k // 9)) + "}",
        "long key": "a" * k + " = 1",
        "similar keys": "".join(f"missio{i}=1\n" for i in range(k // 14)),
        "long title": 'title = "' + "[" * k + '"',
        "vehicle keys": "[vehicle]\n" + "".join(f"mass{i}=1\n" for i in range(k // 11)),
        "long unknown in table": "[vehicle]\n" + "mas" * (k // 3) + " = 1",
        "nulls": "\0" * k,
        "bom": "\ufeff" * (k // 3),
        "surrogate-ish": 'v = "\\uD800' + "a" * k,
        "positions": "mission.goal.position = [" + "1.0," * (k // 4) + "]",
        "dots in lists": "v = [" + "1.5," * (k // 4) + "]",
        "sign": "v = +" + "+" * k,
        "minus space": "- " * (k // 2),
        "brackets closed pairs": "v = [" + "[ ]" * (k // 3),
        "empty headers": "[]\n" * (k // 3),
        "text between": "v = [" + "a b " * (k // 4),
        "name dots": "name." * (k // 5),
        "words": "a " * (k // 2),
        "quoted words": "'a' " * (k // 4),
        "dotted values": "v = " + "1." * (k // 2),
    }


def read_all(size: int, names: tuple[str, ...] = ()) -> int:
    """Read the files of these names, or all, each as a file and as the value of an override.

    Return how many were refused.
    """
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hostile.toml"
        texts = hostile_files(size)
        for text in (texts[name] for name in names or texts):
            file.write_text(text, newline="")
            sound = {"name": "hop", "mission": {"duration": 5, "goal": {"position": [1, 2, 3]}}}
            for arguments in ((file,), (sound, [f"title={text}"])):
                try:
                    load_scenario(*arguments)
                except PyomoQuadError as error:
                    lines = str(error).splitlines()
                    assert 1 <= len(lines) <= 21
                    assert all(len(line) < 2000 for line in lines)
                    refused += 1
    return refused


if __name__ == "__main__":
    print(read_all(int(sys.argv[1]), tuple(sys.argv[2:])))
