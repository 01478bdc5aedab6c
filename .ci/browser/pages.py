"""Opens our pages in headless Chromium, as their readers do, and checks what they see.

usage: pages.py SCREENSHOT_FOLDER REPORT.html.. INDEX.html

Every line that begins with "ok" or "FAILED" is one check. The last line counts them, and the exit
code is 0 only if none failed. Pages that have the class `hit` (flight reports) are also checked for
what they do under the pointer.
"""

import base64
import io
import json
import pathlib
import shutil
import sys

import pypdf
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

WIDTHS = (400, 1600)
SCHEMES = ("light", "dark")
HEIGHT = 900

# Everything that reaches over the right or left edge of the page, or of the drawing that it is in.
# What scrolls in its own box, such as a wide table, does not overflow.
OVERFLOWS = """
const wide = document.documentElement.clientWidth;
const found = [];
if (document.documentElement.scrollWidth > wide)
  found.push('the page is ' + document.documentElement.scrollWidth + ' px wide');
const scrolls = function (element) {
  for (let at = element; at && at !== document.body; at = at.parentElement)
    if (['auto', 'scroll'].includes(getComputedStyle(at).overflowX)) return true;
  return false;
};
for (const element of document.body.querySelectorAll('*')) {
  if (element.closest('svg') || element.closest('.note') || scrolls(element)) continue;
  const box = element.getBoundingClientRect();
  if (box.width > 0 && (box.right > wide + 1 || box.left < -1))
    found.push(element.tagName + ' ' + element.className + ': ' + element.textContent.slice(0, 40));
  const style = getComputedStyle(element);
  if (style.overflowX === 'hidden' && element.scrollWidth > element.clientWidth + 1)
    found.push('cut: ' + element.tagName + ' ' + element.textContent.slice(0, 40));
}
for (const text of document.querySelectorAll('svg text')) {
  const drawing = text.ownerSVGElement.getBoundingClientRect();
  const box = text.getBoundingClientRect();
  if (box.width > 0 && (box.right > drawing.right + 1 || box.left < drawing.left - 1 ||
                        box.bottom > drawing.bottom + 1 || box.top < drawing.top - 1))
    found.push('a drawing cuts: ' + text.textContent.slice(0, 40));
}
return found;
"""

# The contrast of every text with what is behind it, by the formula of WCAG 2. Returns the texts
# below 4.5, and the lightness of the page. Texts in drawings have the drawing behind them.
CONTRAST = """
const parse = function (color) {
  const parts = color.match(/[0-9.]+/g).map(Number);
  return { rgb: parts.slice(0, 3), alpha: parts.length > 3 ? parts[3] : 1 };
};
const luminance = function (rgb) {
  const [r, g, b] = rgb.map(function (value) {
    const share = value / 255;
    return share <= 0.04045 ? share / 12.92 : Math.pow((share + 0.055) / 1.055, 2.4);
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = function (element) {
  for (let at = element; at; at = at.parentElement) {
    const color = parse(getComputedStyle(at).backgroundColor);
    if (color.alpha > 0.99) return color.rgb;
  }
  const dark = getComputedStyle(document.documentElement).colorScheme.includes('dark') &&
    matchMedia('(prefers-color-scheme: dark)').matches;
  return dark ? [18, 18, 18] : [255, 255, 255];
};
const low = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
for (let node = walker.nextNode(); node; node = walker.nextNode()) {
  const element = node.parentElement;
  if (!node.textContent.trim() || ['SCRIPT', 'STYLE'].includes(element.tagName.toUpperCase())) continue;
  if (element.closest('.note') || element.tagName === 'title') continue;
  if (!element.getClientRects().length) continue;
  const style = getComputedStyle(element);
  const color = parse(element.closest('svg') ? style.fill : style.color);
  const [a, b] = [luminance(color.rgb), luminance(behind(element))];
  const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  if (contrast < 4.5) low.push(contrast.toFixed(2) + ': ' + node.textContent.trim().slice(0, 40));
}
return { low: low, ground: luminance(behind(document.body)) };
"""


# Texts of drawings that are too small to be read.
SMALL = """
return [...document.querySelectorAll('svg text')].map(function (text) {
  return [text.getBoundingClientRect().height, text.textContent];
}).filter(function (found) {
  return found[0] > 0 && found[0] < 8.5;
}).map(function (found) {
  return found[0].toFixed(1) + ' px: ' + found[1].trim().slice(0, 40);
});
"""


class Checks:
    def __init__(self):
        self.passed = self.failed = 0

    def __call__(self, holds, what, details=()):
        if holds:
            self.passed += 1
            print(f"ok {what}")
            return
        self.failed += 1
        print(f"FAILED {what}")
        for line in list(details)[:8]:
            print(f"  {line}")


def program(*names):
    for name in names:
        if path := shutil.which(name):
            return path
    sys.exit(f"none of {', '.join(names)} is installed")


def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = program("chromium", "chromium-browser", "google-chrome")
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                     "--hide-scrollbars", "--window-size=1700,1000"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    # A driver that is named is not searched for in the network.
    service = webdriver.ChromeService(executable_path=program("chromedriver"))
    driver = webdriver.Chrome(options=options, service=service)
    # An error while the page loads is not always in the console's log.
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": """
        window.problems = [];
        addEventListener('error', function (event) { problems.push(String(event.message)); });
    """})
    return driver


def emulate(driver, width, scheme):
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": width, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False})
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {
        "features": [{"name": "prefers-color-scheme", "value": scheme}]})


def requested(driver):
    """The addresses that were asked for since the last call."""
    entries = (json.loads(entry["message"])["message"] for entry in driver.get_log("performance"))
    return [entry["params"]["request"]["url"] for entry in entries
            if entry["method"] == "Network.requestWillBeSent"]


def seen(driver, check, page, name, screenshots):
    """What a reader sees, at each width and in each scheme."""
    for width in WIDTHS:
        for scheme in SCHEMES:
            here = f"{name}, {width} px, {scheme}"
            emulate(driver, width, scheme)
            driver.get("about:blank")
            driver.get_log("browser")
            requested(driver)
            driver.get(page.as_uri())
            # Whatever the page asks for later is asked for by then.
            driver.execute_async_script("setTimeout(arguments[0], 150)")
            console = [entry["message"] for entry in driver.get_log("browser")]
            console += driver.execute_script("return window.problems")
            check(not console, f"{here}: no message in the console", console)
            addresses = [url for url in requested(driver)
                         if url != page.as_uri() and not url.startswith("data:")]
            check(not addresses, f"{here}: nothing else is asked for", addresses)
            overflows = driver.execute_script(OVERFLOWS)
            check(not overflows, f"{here}: nothing overflows", overflows)
            small = driver.execute_script(SMALL)
            check(not small, f"{here}: every text of a drawing is 8.5 px high or more", small)
            contrast = driver.execute_script(CONTRAST)
            check(not contrast["low"], f"{here}: every text has a contrast of 4.5", contrast["low"])
            ground = contrast["ground"]
            check(ground > 0.7 if scheme == "light" else ground < 0.1,
                  f"{here}: the page is {scheme}", [f"its luminance is {ground:.3f}"])
            picture = driver.execute_cdp_cmd(
                "Page.captureScreenshot", {"captureBeyondViewport": True})["data"]
            stem = f"{name}-{width}-{scheme}".replace("/", "-")
            (screenshots / f"{stem}.png").write_bytes(base64.b64decode(picture))


def folds(driver, check, name, width):
    """Each fold opens and closes, and nothing overflows while it is open."""
    for index, fold in enumerate(driver.find_elements(By.TAG_NAME, "details")):
        here = f"{name}, {width} px: fold {index + 1}"
        title = fold.find_element(By.TAG_NAME, "summary")

        def height():
            return driver.execute_script("return arguments[0].offsetHeight", fold)

        closed = height()
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", title)
        title.click()
        check(fold.get_property("open") and height() > closed, f"{here} opens")
        overflows = driver.execute_script(OVERFLOWS)
        check(not overflows, f"{here} does not overflow", overflows)
        title.click()
        check(not fold.get_property("open") and height() == closed, f"{here} closes")


def hovers(driver, check, name, width):
    """The slot under the pointer is said in words and marked in every figure."""
    hits = driver.find_elements(By.CSS_SELECTOR, "svg .hit")
    note = driver.find_element(By.CLASS_NAME, "note")
    drawings = {}
    for hit in hits:
        drawing = driver.execute_script("return arguments[0].ownerSVGElement.ariaLabel", hit)
        drawings.setdefault(drawing, []).append(hit)
    for drawing, hits in drawings.items():
        here = f"{name}, {width} px: {drawing.split('.')[0]}"
        # On the map the places of a vehicle that turns back cover each other.
        hit = driver.execute_script("""
            return arguments[0].find(function (hit) {
                hit.scrollIntoView({block: 'center'});
                const box = hit.getBoundingClientRect();
                return hit === document.elementFromPoint((box.left + box.right) / 2,
                                                         (box.top + box.bottom) / 2);
            });""", hits[len(hits) // 2:] + hits[:len(hits) // 2])
        check(hit, f"{here} has a slot that the pointer reaches")
        if not hit:
            continue
        slot = hit.get_attribute("data-slot")
        ActionChains(driver, duration=0).move_to_element(hit).perform()
        state = driver.execute_script("""
            const box = arguments[0].getBoundingClientRect();
            const of_slot = document.querySelectorAll('.hit[data-slot="' + arguments[1] + '"]');
            return {
                words: arguments[0].textContent,
                visible: getComputedStyle(arguments[0]).visibility === 'visible',
                inside: box.left >= 0 && box.top >= 0 && box.right <= innerWidth &&
                    box.bottom <= innerHeight,
                marked: [...of_slot].every(function (hit) { return hit.classList.contains('on'); }),
                others: document.querySelectorAll('.hit.on').length - of_slot.length,
            };""", note, slot)
        check(state["visible"] and state["inside"] and f"slot {slot}" in state["words"].lower(),
              f"{here} says the slot under the pointer", [str(state)])
        check(state["marked"] and state["others"] == 0,
              f"{here} marks the slot in all figures", [str(state)])
    heading = driver.find_element(By.TAG_NAME, "h1")
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", heading)
    ActionChains(driver, duration=0).move_to_element(heading).perform()
    left = driver.execute_script(
        "return [document.querySelectorAll('.hit.on').length, "
        "getComputedStyle(arguments[0]).visibility]", note)
    check(left == [0, "hidden"], f"{name}, {width} px: nothing stays marked", [str(left)])


def printed(driver, check, page, name, screenshots):
    """The page on paper, from the dark scheme: its texts are there and inside the sheets."""
    emulate(driver, WIDTHS[1], "dark")
    driver.get(page.as_uri())
    expected = [element.text for element in driver.find_elements(By.CSS_SELECTOR, "h1, h2")
                if element.is_displayed() and not element.find_elements(By.XPATH, "ancestor::details")]
    pdf = driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
    data = base64.b64decode(pdf)
    (screenshots / f"{name}.pdf".replace("/", "-")).write_bytes(data)
    reader = pypdf.PdfReader(io.BytesIO(data))
    sheets = len(reader.pages)
    check(1 <= sheets <= 20, f"{name}, printed: {sheets} pages")
    texts, outside = [], []
    for number, sheet in enumerate(reader.pages, 1):
        box = sheet.mediabox

        def visit(text, matrix, text_matrix, *_):
            x = matrix[0] * text_matrix[4] + matrix[2] * text_matrix[5] + matrix[4]
            y = matrix[1] * text_matrix[4] + matrix[3] * text_matrix[5] + matrix[5]
            if text.strip() and not (0 <= x <= box.width and 0 <= y <= box.height):
                outside.append(f"page {number}, ({x:.0f}, {y:.0f}): {text.strip()[:40]}")

        texts.append(sheet.extract_text(visitor_text=visit))
    text = "".join("".join(texts).split())
    missing = [words for words in expected if "".join(words.split()) not in text]
    check(not missing and expected, f"{name}, printed: all {len(expected)} headings are there", missing)
    check(not outside, f"{name}, printed: every text begins on its sheet", outside)


def main():
    screenshots, *pages = (pathlib.Path(argument).resolve() for argument in sys.argv[1:])
    screenshots.mkdir(parents=True, exist_ok=True)
    check = Checks()
    driver = browser()
    try:
        for page in pages:
            name = f"{page.parent.name}/{page.stem}"
            seen(driver, check, page, name, screenshots)
            for width in WIDTHS:
                emulate(driver, width, "light")
                driver.get(page.as_uri())
                folds(driver, check, name, width)
                if driver.find_elements(By.CSS_SELECTOR, "svg .hit"):
                    hovers(driver, check, name, width)
            printed(driver, check, page, name, screenshots)
    finally:
        driver.quit()
    print(f"pages: {check.passed} passed, {check.failed} failed")
    sys.exit(check.failed > 0 or check.passed == 0)


main()
