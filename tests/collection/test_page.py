"""collection.html in a browser: 2,000 rows are sorted and filtered, and 100,000 open."""

import json
import time
from pathlib import Path

import numpy as np
from browser import Browser
from selenium.webdriver.common.by import By

from gsc_jax.collection.page import MARK, collection_page
from gsc_jax.collection.record import complete

ERROR = "</script><b>not a scene</b>"


def made_rows(count: int) -> list[dict]:
    rng = np.random.default_rng(0)
    rows = []
    for index, probability in enumerate(rng.beta(0.5, 2, count).tolist()):
        row = {"id": f"scene {index}.ply", "scene_probability": probability, "gaussians": index}
        row |= {"labelled_share": probability / 3, "bytes": 250 * index, "seconds": 1.5}
        row |= {"traces": ["copy-move"] if index % 50 == 7 else []}
        row |= {"report": f"{index}/report.html" if probability > 0.9 else None}
        if index % 5 == 4:
            row = {"id": f"bad {index}.ply", "error_class": "InputError", "error": ERROR}
        rows.append(complete(row))
    return rows


def opened(browser: Browser, folder: Path, rows: list[dict]) -> None:
    (folder / "collection.html").write_text(collection_page(rows), "utf-8")
    browser.get((folder / "collection.html").as_uri())


def column(browser: Browser, number: int) -> list[str]:
    """The texts of a column, of the rows that exist."""
    return browser.execute_script(
        "const rows = [...document.querySelectorAll('tr.scene')];"
        "return rows.map(row => row.cells[arguments[0]].textContent)",
        number,
    )


def shown(browser: Browser) -> str:
    return browser.find_element(By.ID, "shown").text


def sort(browser: Browser, number: int) -> None:
    browser.find_element(By.CSS_SELECTOR, f"th button[data-column='{number}']").click()


def test_rows_are_sorted_and_filtered(browser, tmp_path):
    rows = made_rows(2_000)
    opened(browser, tmp_path, rows)
    assert shown(browser) == "2,000 shown"
    best = sorted((row["scene_probability"] or 0 for row in rows), reverse=True)
    assert column(browser, 1)[:9] == [f"{probability:.3f} evidence" for probability in best[:9]]
    assert len(column(browser, 0)) < 100, "elements exist for visible rows only"
    sort(browser, 0)
    names = sorted(row["id"] for row in rows)
    assert column(browser, 0)[:9] == names[:9]
    sort(browser, 0)
    assert column(browser, 0)[:9] == names[:-10:-1]
    browser.find_element(By.ID, "filter").send_keys("copy-move 7")
    expected = [row for row in rows if row["traces"] and "7" in row["id"]]
    assert shown(browser) == f"{len(expected)} shown"
    assert all("copy-move" in text for text in column(browser, 6))
    browser.find_element(By.CSS_SELECTOR, "[data-filter=InputError]").click()
    assert shown(browser) == "400 shown"
    assert column(browser, 7)[0] == f"InputError: {ERROR}", "an error is text and never markup"
    browser.find_element(By.CSS_SELECTOR, "[data-filter='outcome:inconclusive']").click()
    unclear = sum(0.35 <= (row["scene_probability"] or 0) < 0.65 for row in rows)
    assert shown(browser) == f"{unclear} shown"
    assert all("inconclusive" in text for text in column(browser, 1))
    assert [e for e in browser.errors() if "overview.png" not in e] == []
    assert browser.foreign_requests() == []


def test_scrolling_reaches_the_last_row(browser, tmp_path):
    opened(browser, tmp_path, made_rows(2_000))
    sort(browser, 3)
    browser.execute_script("document.getElementById('box').scrollTop = 1e9")
    time.sleep(0.3)
    assert column(browser, 7)[-1] == f"InputError: {ERROR}", "rows without a value are last"


def test_a_hundred_thousand_rows_open(browser, tmp_path):
    opened(browser, tmp_path, made_rows(100_000))
    assert shown(browser) == "100,000 shown"
    sort(browser, 3)
    assert column(browser, 3)[0] == "99,998"
    assert len(column(browser, 0)) < 100, "elements exist for visible rows only"
    assert (tmp_path / "collection.html").stat().st_size < 20e6


def test_data_and_mark():
    page = collection_page(made_rows(10))
    assert MARK in page[:100]
    data = page.partition('id="data">')[2].partition("</script>")[0]
    assert json.loads(data)[4][8] == ERROR
    assert "<b>not" not in page
