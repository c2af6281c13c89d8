"""The dashboard's headline, drawn as an image because rerun's text has no colours.

One line and one colour: red for a fault, amber while a vehicle waits, green in flight, grey after
the flight.
"""

from io import BytesIO
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT, MARGIN = 1600, 88, 22  # [pixels]
SIZES = (46, 40, 34, 28, 23)  # of letters [pixels]: the largest that fits is used
RED, AMBER, GREEN, GREY = (200, 30, 38), (168, 101, 0), (24, 92, 62), (44, 52, 64)

Colour = tuple[int, int, int]


class Banner(NamedTuple):
    """Text and background colour of the headline."""

    words: str
    colour: Colour


def picture(banner: Banner) -> bytes:
    """The banner with verdict and events, as PNG."""
    image = Image.new("RGB", (WIDTH, HEIGHT), banner.colour)
    pen, words = ImageDraw.Draw(image), banner.words
    for size in SIZES:
        font = ImageFont.load_default(size)
        if pen.textlength(words, font=font) <= WIDTH - 2 * MARGIN:
            break
    while pen.textlength(words, font=font) > WIDTH - 2 * MARGIN:
        words = words.removesuffix(" ...")[:-1] + " ..."
    pen.text((MARGIN, HEIGHT / 2), words, fill=(255, 255, 255), font=font, anchor="lm")
    out = BytesIO()
    image.save(out, format="PNG", optimize=False)
    return out.getvalue()
