"""The HTML page says what the Markdown says, and no text of it acts as markup."""

import json
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.report.page import render_html
from pyomo_quad.report.paths import script_json, view_data
from pyomo_quad.report.style import styled_flights
from tests.synthetic_run import synthetic_run
from tests.unit.report.test_markdown import every_block, words_of

VOID = {"meta", "link", "img", "wbr"}
# What a text may have in it as markup: a code span, and where a long name may break.
INLINE = {"code", "wbr"}


class Reader(HTMLParser):
    """Collects tags and text, and refuses tags that do not close."""

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.text, self.attributes = [], [], [], []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def render(text):
    return render_html(
        every_block(text),
        is_good=True,
        pictures={"path": b"<svg/>"},
        views={"path": "<p>view</p>"},
        data='{"run": 1}',
    )


@pytest.fixture(scope="module")
def plain():
    return Reader(render("text"))


# What is blank has no words to compare.
@pytest.mark.lengthy
@given(text=st.text().filter(str.strip))
def test_no_text_adds_a_tag_or_an_attribute(plain, text):
    told = Reader(render(text))
    # A text that a code span cannot hold stands as plain text.
    kept, wanted = ([t for t in page.tags if t not in INLINE] for page in (told, plain))
    assert kept == wanted
    assert [name for name, _ in told.attributes] == [name for name, _ in plain.attributes]


@pytest.mark.lengthy
@given(st.text().filter(str.strip))
def test_page_prints_any_text_as_it_stands(text):
    page, words = render(text).replace("<wbr>", ""), words_of(text)
    for place in (
        "<title>(.*?)</title>",
        "<h1>(.*?)</h1>",
        "<strong>(.*?)</strong>",
        "<caption><strong>Table of (.*?)</strong></caption>",
        '<td class="number">(.*?)</td>',
        '<img alt="(.*?)" src',
        "<figcaption><em>Caption: (.*?).</em></figcaption>",
    ):
        assert unescape(re.search(place, page)[1]) == words
    cell = re.search('<th scope="row">(.*?)</th>', page)[1]
    assert unescape(re.sub("</?code>", "", cell)).split() == words.split()


def test_page_holds_every_text():
    told = " ".join(Reader(render("a <b> & 'c' \"d\"")).text)
    assert told.count("a <b> & 'c' \"d\"") == 16


def test_page_is_for_phones_readers_and_paper():
    page = render("text")
    assert '<html lang="en">' in page
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in page
    assert "@media print" in page
    assert '<th scope="row">' in page
    assert re.search(r'<img alt="[^"]+"', page)


def test_page_may_not_load_anything():
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', render("text"))[1]
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy


def test_view_holds_the_paths_and_no_end_of_script():
    run = synthetic_run(flights=("optimal", "adaptive/quintic"))
    text = script_json(view_data(styled_flights(run.flights), run.scenario.airspace, 0.2))
    data = json.loads(text)
    optimum, other = data["flights"]
    assert [optimum["name"], other["name"]] == ["optimal", "adaptive/quintic"]
    assert [optimum[axis][-1] for axis in "xyz"] == list(run.scenario.mission.goal.position)
    shown = [signal["key"] for _, signals in data["groups"] for signal in signals]
    # Every column of the table but the time and what others are made of.
    assert set(run.flights[0].frame) - set(shown) == {"time_s", "thrust_N"}
    assert all(len(optimum["series"][key]) == len(optimum["t"]) for key in shown)
    assert "</script" not in script_json({"name": "</script><script>attack()"})


def test_the_contents_stand_once_below_the_last_verdict():
    """A report of a free time gives two verdicts."""
    text = "# Title\n\n> one\n\nbetween\n\n> two\n\n## Part\n\ntext\n"
    page = render_html(text, is_good=True, pictures={}, views={}, data="{}")
    assert page.count("<nav") == 1
    assert page.index("two") < page.index("<nav") < page.index("<h2")


def test_a_flight_that_comes_home_has_its_ends_at_one_mark():
    run = synthetic_run()
    there = styled_flights(run.flights)[0]
    back = there.frame.iloc[::-1].assign(time_s=there.frame["time_s"].to_numpy())
    later = back.assign(time_s=back["time_s"] + there.frame["time_s"].iloc[-1])
    home = replace(there, frame=pd.concat([there.frame, later]))
    ends = [view_data((flight,), run.scenario.airspace, 0.2)["ends"] for flight in (there, home)]
    assert [[name for name, _ in named] for named in ends] == [
        ["start", "goal"],
        ["start and goal"],
    ]
