"""report.html in a real browser: it draws, says what it should, and loads and runs nothing else."""

import re
import shutil
from contextlib import contextmanager
from itertools import combinations

import pytest

from pyomo_quad.report import Figures
from pyomo_quad.report.report import PAGE_NAME, write_run_report
from pyomo_quad.study.autopilot import TUNED_CRUISE
from tests.synthetic_run import FLIGHTS, synthetic_run, with_tuned_autopilot

pytestmark = [pytest.mark.browser, pytest.mark.lengthy]

selenium = pytest.importorskip(
    "selenium", reason="selenium is not installed: pip install '.[test]'"
)

TITLE = "<script>window.attacked = true</script> *gust* [x](javascript:alert(1)) & | `co`"
ZONE = (
    'airspace.keep_out=[{name="mast",shape="cylinder",centre=[3.0,2.0],radius=0.5,bottom=0.0,'
    "top=40.0}]"
)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
TABLET = {"width": 820, "height": 1180, "deviceScaleFactor": 2, "mobile": True}
TIMEOUT = 60  # s; drawing in software on a busy machine is slow

VIEW_ELEMENT = "flight-view"
FLOWN = [TUNED_CRUISE if name == "adaptive/minimum_snap" else name for name in FLIGHTS]
WIDE = {"width": 1400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
AFTER_FRAME = "requestAnimationFrame"
TALLEST = 6000  # px, with details folded


def _executable(*names):
    found = next((path for path in map(shutil.which, names) if path), None)
    if found is None:
        pytest.skip(f"no {names[0]} on this machine; install chromium and chromium-driver")
    return found


@contextmanager
def _browser():
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = _executable(*BROWSERS)
    for argument in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "window-size=1200,900"):
        options.add_argument(f"--{argument}")
    options.add_argument("--enable-unsafe-swiftshader")  # WebGL without a graphics card
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    # Naming the driver keeps selenium from looking for one to download.
    driver = webdriver.Chrome(options=options, service=Service(_executable("chromedriver")))
    try:
        yield driver
    finally:
        driver.quit()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    from selenium.webdriver.support.ui import WebDriverWait

    with _browser() as browser:
        folder = tmp_path_factory.mktemp("report")
        result = with_tuned_autopilot(synthetic_run(overrides=(f"title={TITLE!r}", ZONE)))
        write_run_report(folder, result, Figures.PNG)
        browser.set_page_load_timeout(TIMEOUT)
        browser.get((folder / PAGE_NAME).as_uri())
        WebDriverWait(browser, TIMEOUT).until(
            lambda b: b.execute_script(f"return !!document.querySelector('#{VIEW_ELEMENT} canvas')")
        )
        yield browser


def test_console_has_no_error(page):
    log = page.get_log("browser")
    assert [entry for entry in log if entry["level"] == "SEVERE"] == []


def test_view_shows_every_flight(page):
    names = page.execute_script(
        f"return document.getElementById('{VIEW_ELEMENT}').data.map(trace => trace.name)"
    )
    assert names[: len(FLIGHTS)] == FLOWN
    size = page.execute_script(
        f"const box = document.querySelector('#{VIEW_ELEMENT} canvas').getBoundingClientRect();"
        "return [box.width, box.height]"
    )
    assert min(size) > 200


def test_comparison_table_has_a_row_for_each_flight(page):
    rows = page.execute_script(
        "return [...document.querySelectorAll('table')[0].querySelectorAll('tbody th')]"
        ".map(cell => cell.textContent)"
    )
    assert rows == FLOWN


def test_every_figure_is_drawn(page):
    widths = page.execute_script(
        "return [...document.images].map(image => image.naturalWidth * image.complete)"
    )
    assert len(widths) >= 9
    assert min(widths) > 0


def test_title_is_shown_and_not_run(page):
    assert page.execute_script("return document.querySelector('h1').textContent") == TITLE
    assert page.title == " ".join(TITLE.split())
    assert page.execute_script("return window.attacked") is None
    assert page.execute_script("return document.querySelectorAll('h1 *:not(wbr)').length") == 0


def test_nothing_is_loaded_from_anywhere(page):
    loaded = page.execute_script(
        "return performance.getEntriesByType('resource').map(entry => entry.name)"
    )
    assert [name for name in loaded if not name.startswith(("data:", "blob:"))] == []


def test_answer_stands_in_the_first_screen(page):
    bottom = page.execute_script(
        "return document.querySelector('.verdict').getBoundingClientRect().bottom + scrollY"
    )
    assert bottom < page.execute_script("return innerHeight")


def test_phone_scrolls_in_one_direction_only(page):
    width = on_a_screen(page, PHONE, "return document.documentElement.scrollWidth")
    assert width <= PHONE["width"]


def settle(page):
    """Wait for two frames: a phone folds the page's contents in the frame after the resize."""
    page.execute_async_script(
        f"const done = arguments[0]; {AFTER_FRAME}(() => {AFTER_FRAME}(done))"
    )


def on_a_screen(page, screen, script):
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    try:
        settle(page)
        return page.execute_script(script)
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        settle(page)


@pytest.mark.parametrize("screen", [PHONE, TABLET], ids=["phone", "tablet"])
def test_no_table_is_cut(page, screen):
    wide = on_a_screen(
        page,
        screen,
        "return [...document.querySelectorAll('table, td, tbody th, figure img, .chart')]"
        ".filter(part => part.getBoundingClientRect().right > innerWidth + 1).length",
    )
    assert wide == 0


def test_a_phone_names_each_cell(page):
    beside = (
        "return getComputedStyle(document.querySelector('.cards td.number'), '::before').content"
    )
    assert on_a_screen(page, PHONE, beside) == '"Duration (s)"'


SCREENS = pytest.mark.parametrize("screen", [PHONE, WIDE], ids=["390 px", "1400 px"])


@SCREENS
def test_headline_map_and_total_energies_are_in_the_first_screen(page, screen):
    ends = on_a_screen(
        page,
        screen,
        "scrollTo(0, 0); return ['.verdict', '.top figure img', '.top tbody tr:nth-child(3)'].map("
        "name => document.querySelector(name).getBoundingClientRect().bottom)",
    )
    assert max(ends) <= screen["height"]


@SCREENS
def test_the_page_is_short_with_its_details_folded(page, screen):
    height = on_a_screen(page, screen, "return document.documentElement.scrollHeight")
    assert height < TALLEST
    shown = on_a_screen(page, screen, "return document.documentElement.scrollWidth")
    assert shown <= screen["width"]


CONTRAST = 4.5  # WCAG AA for text


def luminance(color):
    parts = [int(part) / 255 for part in re.findall(r"\d+", color)[:3]]
    lines = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return sum(share * c for share, c in zip((0.2126, 0.7152, 0.0722), lines, strict=True))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_in_light_and_dark(page, scheme):
    told = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", told)
    try:
        background = page.execute_script("return getComputedStyle(document.body).backgroundColor")
        colors = page.execute_script(
            "return ['body', 'nav a', 'figcaption', '.top td'].map("
            "name => getComputedStyle(document.querySelector(name)).color)"
        )
        boxes = page.execute_script(
            "return ['.verdict', '.verdict strong'].map(name => ["
            "getComputedStyle(document.querySelector('.verdict')).backgroundColor,"
            "getComputedStyle(document.querySelector(name)).color])"
        )
    finally:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert (luminance(background) < 0.2) == (scheme == "dark")
    for under, color in [*((background, color) for color in colors), *boxes]:
        low, high = sorted((luminance(under), luminance(color)))
        assert (high + 0.05) / (low + 0.05) >= CONTRAST


def test_the_contents_name_the_player_and_open_a_folded_section(page):
    links = page.execute_script(
        "return [...document.querySelectorAll('nav a')].map(a => a.textContent)"
    )
    assert "Paths and player" in links
    is_open = "return document.getElementById('verification').open"
    assert not page.execute_script(is_open)
    page.execute_script("document.querySelector('nav a[href=\"#verification\"]').click()")
    page.execute_async_script("setTimeout(arguments[0], 100)")
    assert page.execute_script(is_open)
    page.execute_script("document.getElementById('verification').open = false")


def test_the_vehicle_is_marked_as_enlarged(page):
    """The arm of the paper's vehicle is 0.175 m, drawn as a twentieth of the scene."""
    said = page.execute_script("return document.getElementById('flight-scale').textContent")
    times = float(re.fullmatch(r"The vehicle is drawn ([\d.]+) times its size.", said)[1])
    assert times > 2.0


def test_the_player_and_a_picture_work_from_the_keyboard(page):
    from selenium.webdriver.common.keys import Keys

    canvas = page.find_element("css selector", f"#{VIEW_ELEMENT} canvas")
    turned = f"return document.getElementById('{VIEW_ELEMENT}').camera.azimuth"
    before = page.execute_script(turned)
    canvas.send_keys(Keys.ARROW_RIGHT)
    assert page.execute_script(turned) > before
    canvas.send_keys(Keys.ARROW_LEFT)
    button = page.find_element("id", "flight-play")
    canvas.send_keys(" ")
    assert button.text == "Pause"
    canvas.send_keys(" ")
    assert button.text == "Play"
    image = page.find_element("css selector", "figure img")
    image.send_keys(Keys.ENTER)
    assert "large" in image.get_attribute("class")
    image.send_keys(Keys.ENTER)
    assert "large" not in image.get_attribute("class")


def test_the_contents_stand_once(page):
    assert page.execute_script("return document.querySelectorAll('nav').length") == 1


def seconds(page):
    clock = page.execute_script("return document.getElementById('flight-clock').textContent")
    return float(clock.split()[0])


def pixels(page):
    return page.execute_script(
        f"return document.querySelector('#{VIEW_ELEMENT} canvas').toDataURL()"
    )


def test_play_moves_time_and_vehicle_until_pause(page):
    from selenium.webdriver.support.ui import WebDriverWait

    before = pixels(page)
    button = page.find_element("id", "flight-play")
    page.execute_script("document.getElementById('flight-play').click()")
    WebDriverWait(page, TIMEOUT).until(lambda browser: seconds(browser) > 0.2)
    assert button.text == "Pause"
    page.execute_script("document.getElementById('flight-play').click()")
    assert button.text == "Play"
    paused = seconds(page)
    assert 0.2 < paused <= 10.0
    assert pixels(page) != before
    assert seconds(page) == paused


@pytest.fixture
def charts(page):
    """Unfold the charts of all quantities."""
    page.execute_script("document.getElementById('flight-series').open = true")
    yield page.execute_async_script("setTimeout(arguments[0], 200)")
    page.execute_script("document.getElementById('flight-series').open = false")


@pytest.mark.usefixtures("charts")
def test_slider_sets_the_time_of_every_chart(page):
    page.execute_script(
        "const slider = document.getElementById('flight-time'); slider.value = 5;"
        "slider.dispatchEvent(new Event('input'))"
    )
    assert seconds(page) == 5.0
    cursors = page.execute_script(
        "return [...new Set([...document.querySelectorAll('.plot i')].map(c => c.style.left))]"
    )
    assert cursors == ["50%"]
    # The optimum's path is a quintic from 0 to 6 m: half of it at half the time.
    read = page.execute_script("return document.querySelector('.chart .values').textContent")
    assert read.startswith("3.00")


@pytest.mark.usefixtures("charts")
def test_pointing_at_a_chart_reads_that_time(page):
    from selenium.webdriver import ActionChains

    plot = page.find_elements("css selector", ".plot")[4]
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    ActionChains(page).move_to_element_with_offset(plot, plot.size["width"] // 4, 0).perform()
    assert seconds(page) == pytest.approx(7.5, abs=0.1)


def test_drag_turns_the_view(page):
    from selenium.webdriver import ActionChains

    turned = f"return document.getElementById('{VIEW_ELEMENT}').camera.azimuth"
    before, picture = page.execute_script(turned), pixels(page)
    canvas = page.find_element("css selector", f"#{VIEW_ELEMENT} canvas")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    ActionChains(page).drag_and_drop_by_offset(canvas, 150, 0).perform()
    assert page.execute_script(turned) - before == pytest.approx(1.0, abs=0.1)
    assert pixels(page) != picture


def test_labels_in_the_view_do_not_meet_on_a_phone(page):
    """From all around, and all inside; the ends, the axes and the zone are named."""
    written = on_a_screen(
        page,
        PHONE,
        f"const view = document.getElementById('{VIEW_ELEMENT}');"
        "const slider = document.getElementById('flight-time'), before = view.camera.azimuth;"
        "const seen = Array.from({length: 24}, (_, k) => {"
        "  view.camera.azimuth = before + k * Math.PI / 12; slider.value = 5;"
        "  slider.dispatchEvent(new Event('input')); return view.labels; });"
        "view.camera.azimuth = before; slider.dispatchEvent(new Event('input'));"
        "return [view.clientWidth, view.clientHeight, seen]",
    )
    width, height, seen = written
    assert width <= PHONE["width"]
    for labels in seen:
        assert all(one["left"] >= 0 and one["right"] <= width for one in labels)
        assert all(one["top"] >= 0 and one["bottom"] <= height for one in labels)
        for one, other in combinations(labels, 2):
            is_aside = one["right"] <= other["left"] or other["right"] <= one["left"]
            assert is_aside or one["bottom"] <= other["top"] or other["bottom"] <= one["top"]
    assert {"start", "goal", "x (m)", "y (m)", "z (m)", "mast"} <= {one["text"] for one in seen[0]}


def test_a_table_sorts_by_its_numbers_both_ways(page):
    column = (
        "return [...document.querySelectorAll('table')[0].tBodies[0].rows]"
        ".map(row => row.cells[1].textContent)"
    )
    click = "document.querySelectorAll('table')[0].tHead.querySelectorAll('button')[1].click()"
    page.execute_script(click)
    rising = [float(text) for text in page.execute_script(column)]
    assert rising == sorted(rising)
    assert len(set(rising)) > 2
    page.execute_script(click)
    assert [float(text) for text in page.execute_script(column)] == sorted(rising, reverse=True)


def test_zones_and_wind_are_in_the_view(page):
    data = page.execute_script(
        "return JSON.parse(document.getElementById('flight-data').textContent)"
    )
    (zone,) = data["zones"]
    assert (zone["name"], zone["low"], zone["high"]) == (
        "mast",
        {"x": 2.5, "y": 1.5, "z": 0},
        {"x": 3.5, "y": 2.5, "z": 40},
    )
    assert len(data["flights"][0]["wind"]) == 2
    assert data["flights"][0]["phi"]


def test_the_page_is_light(page):
    size = page.execute_script("return document.documentElement.outerHTML.length")
    assert size < 3_000_000


def test_print_replaces_the_view_by_the_figure(page):
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        shown = page.execute_script(
            "return ['.view', 'nav', 'figure img'].map("
            "name => getComputedStyle(document.querySelector(name)).display)"
        )
    finally:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert shown == ["none", "none", "block"]
