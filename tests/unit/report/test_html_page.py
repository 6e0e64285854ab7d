"""The HTML page says what the document says, and no text of it acts as markup."""

import json
import re
from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.report.paths import view_script
from pyomo_quad.report.render import (
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Picture,
    Strong,
    Table,
    Verdict,
    render_html,
)
from pyomo_quad.report.style import styled_flights
from tests.synthetic_run import synthetic_run

VOID = {"meta", "link", "img"}


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


def document_of(text):
    return Document(
        title=text,
        blocks=(
            Verdict(is_good=True, pieces=(Strong(text), text)),
            Heading(text),
            Paragraph((text, Code(text))),
            Bullets(((text,),)),
            Table(caption=text, header=(text, text), rows=((Code(text), text),)),
            Picture(name="path", title=text, caption=text),
        ),
    )


def render(text):
    return render_html(document_of(text), {"path": b"<svg/>"}, {"path": "<p>view</p>"}, "run();")


@given(st.text(st.characters(exclude_categories=["Cc", "Cs"])))
def test_no_text_adds_a_tag_or_an_attribute(text):
    plain, told = Reader(render("text")), Reader(render(text))
    assert told.tags == plain.tags
    assert [name for name, _ in told.attributes] == [name for name, _ in plain.attributes]


def test_page_holds_every_text():
    told = " ".join(Reader(render("a <b> & 'c' \"d\"")).text)
    assert told.count("a <b> & 'c' \"d\"") == 15


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
    script = view_script(styled_flights(run.flights))
    call = script[script.rindex("Plotly.newPlot(") + len("Plotly.newPlot(") : -2]
    _, traces, _, _ = json.loads(f"[{call}]")
    assert [trace.get("name") for trace in traces[:2]] == ["optimal", "adaptive/quintic"]
    assert [traces[0][axis][-1] for axis in "xyz"] == list(run.scenario.mission.goal.position)
    assert "</script" not in script
