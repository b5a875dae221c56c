"""Figures on a dark page: a style sheet in the SVG replaces its greys where the reader prefers dark pages."""

from collections.abc import Mapping

from bojax.report import style

_GREYS: Mapping[str, str] = {
    style.INK: "#e7e9ec",
    "#444444": "#b9c0c9",
    "#555555": "#8d96a1",
    style.GREY: "#a3abb5",
    "#E4E4E4": "#343a42",
    "#F6F6F4": "#252a31",
    "#4A4A4A": "#9aa3ad",
    style.BLUE: "#4ba3e3",
    style.BROWN: "#b98a62",
    **{
        style.mixed(ink, other, share): style.mixed(ink, "white", min(0.85, share + 0.15))
        for ink in style.PALETTE
        for other, share in style.SHADES
        if other == "black"
    },
}
"""Replacements of the colours that are too dark or too bright on a dark page."""

_CARD = "#1c2025"


def adapted(svg: bytes) -> bytes:
    """Add dark colours to an SVG of matplotlib; they apply only where the reader prefers dark pages.

    The colours of a map, which is an image, do not change, and the colours of lines were chosen to stand out
    from it. In a figure with a map, only the background and the text change.
    """
    where = "[id^=text_] " if b"<image" in svg else ""
    rules = [f"#patch_1 path{{fill:{_CARD}!important}}", "svg{fill:#e7e9ec}"]
    for light, dark in _GREYS.items():
        for kind in ("fill", "stroke"):
            rules.append(f'{where}[style*="{kind}: {light.lower()}"]{{{kind}:{dark}!important}}')
    sheet = f"<style>@media (prefers-color-scheme: dark){{{''.join(rules)}}}</style>"
    begin, found, rest = svg.partition(b"<metadata>")
    return begin + sheet.encode() + found + rest if found else svg
