"""report.html in a real browser: it draws, says what it should, and loads and runs nothing else."""

import shutil
from contextlib import contextmanager

import pytest

from pyomo_quad.report.paths import VIEW_ELEMENT
from pyomo_quad.report.report import PAGE_NAME, write_run_report
from tests.synthetic_run import FLIGHTS, synthetic_run

pytestmark = pytest.mark.browser

selenium = pytest.importorskip(
    "selenium", reason="selenium is not installed: pip install '.[test]'"
)

TITLE = "<script>window.attacked = true</script> *gust* [x](javascript:alert(1)) & | `co`"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
TIMEOUT = 60  # s; drawing in software on a busy machine is slow


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
        write_run_report(folder, synthetic_run(overrides=(f"title={TITLE!r}",)))
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
    assert names[: len(FLIGHTS)] == list(FLIGHTS)
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
    assert rows == list(FLIGHTS)


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
    assert page.execute_script("return document.querySelectorAll('h1 *').length") == 0


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
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", PHONE)
    try:
        width = page.execute_script("return document.documentElement.scrollWidth")
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert width <= PHONE["width"]


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
