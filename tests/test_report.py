"""The HTML page: whole, escaped, self-contained."""

import base64
import io
import re

import numpy as np
from PIL import Image

from jaxisp.report import Page


def test_page(tmp_path):
    page = Page("A <b>title</b>", "lead")
    page.heading("Section", "what it shows")
    page.figures([("caption & more", np.full((4, 6, 3), 0.5))], magnify=3)
    page.table(("a", "b"), [(1, "<x>")])
    page.write(tmp_path / "p.html")
    text = (tmp_path / "p.html").read_text()
    assert "A &lt;b&gt;title" in text and "&lt;x&gt;" in text and "caption &amp; more" in text
    picture = Image.open(io.BytesIO(base64.b64decode(re.search(r"base64,([^\"]+)", text)[1])))
    assert picture.size == (18, 12) and picture.getpixel((0, 0)) == (128, 128, 128)
    assert not re.search(r"(src|href)=\"(?!data:)", text)


def test_names_of_others_stand_in_a_page_as_text():
    page = Page("a\x1b[2J", "\u202eback <script>")
    page.table(["\x9b"], [["b\x07"]])
    text = page.html()
    assert all(line.isprintable() for line in text.split("\n"))
    assert "a\\x1b[2J" in text and "\\u202eback &lt;script&gt;" in text
