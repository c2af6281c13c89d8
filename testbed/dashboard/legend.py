"""The legend beside the dashboard's plots, drawn as an image, so that it hides no curve."""

from collections.abc import Sequence
from io import BytesIO

from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT, MARGIN, LETTERS = 1300, 44, 16, 25  # [pixels]
BACK, INK = (16, 20, 26), (220, 226, 234)

Colour = tuple[int, int, int]


def picture(entries: Sequence[tuple[str, Colour, bool]]) -> bytes:
    """Name, colour, and whether it is a line instead of a disc, as PNG."""
    image = Image.new("RGB", (WIDTH, HEIGHT), BACK)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(LETTERS)
    at, middle = MARGIN, HEIGHT // 2
    for name, colour, line in entries:
        if line:
            pen.line((at, middle, at + 30, middle), colour, 4)
        else:
            pen.ellipse((at + 5, middle - 10, at + 25, middle + 10), fill=colour)
        at += 38
        pen.text((at, middle), name, INK, font=font, anchor="lm")
        at += round(pen.textlength(name, font=font)) + 26
    out = BytesIO()
    image.save(out, format="PNG")
    return out.getvalue()
