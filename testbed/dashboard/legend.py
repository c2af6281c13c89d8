"""The legend beside the dashboard's plots, drawn as an image, so that it hides no curve."""

from collections.abc import Sequence
from io import BytesIO

from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT, MARGIN, LETTERS, SMALLEST = 1300, 44, 16, 25, 11  # [pixels]
BACK, INK = (16, 20, 26), (220, 226, 234)

Colour = tuple[int, int, int]


def picture(entries: Sequence[tuple[str, Colour, bool]]) -> bytes:
    """Name, colour, and whether it is a line instead of a disc, as PNG.

    Letters are smaller where many or long names would not fit.
    """
    image = Image.new("RGB", (WIDTH, HEIGHT), BACK)
    pen, middle = ImageDraw.Draw(image), HEIGHT // 2
    for letters in range(LETTERS, SMALLEST - 1, -1):
        font, share = ImageFont.load_default(letters), letters / LETTERS
        sample, gap = 38 * share, 26 * share
        wide = [sample + pen.textlength(name, font=font) + gap for name, _, _ in entries]
        if 2 * MARGIN + sum(wide) - gap <= WIDTH:
            break
    at = float(MARGIN)
    for (name, colour, line), width in zip(entries, wide, strict=True):
        if line:
            pen.line((at, middle, at + 30 * share, middle), colour, 4)
        else:
            left, high = at + 5 * share, 10 * share
            pen.ellipse((left, middle - high, left + 2 * high, middle + high), fill=colour)
        pen.text((at + sample, middle), name, INK, font=font, anchor="lm")
        at += width
    out = BytesIO()
    image.save(out, format="PNG")
    return out.getvalue()
