"""What the README and the documentation contain: fenced blocks, commands, links."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

Block = tuple[str, str, str | None]
"""Language, content, and the file of examples/ that the block shows."""


def blocks(page: Path) -> list[Block]:
    pattern = r"(?:^<!-- (?P<file>\S+) -->\n)?^```(?P<language>\w*)\n(?P<content>.*?)^```$"
    found = re.finditer(pattern, page.read_text(), re.MULTILINE | re.DOTALL)
    return [(match["language"], match["content"], match["file"]) for match in found]


def commands(page: Path) -> list[list[str]]:
    """The lines of the page's shell blocks as words, without comments."""
    lines = [line for kind, content, _ in blocks(page) if kind == "sh" for line in content.splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def links(page: Path) -> list[str]:
    """Targets of links and images that are files of the repository."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"\]\(([^)#]+)[^)]*\)", text) + re.findall(r'src="([^"]+)"', text)
    return [target for target in targets if "://" not in target]
