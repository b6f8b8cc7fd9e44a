"""Check README and docs: links, commands, names, nothing of this machine; print every fault, exit 1 if any."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CODE_BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\)|<(?:img|a)[^>]+(?:src|href)=\"([^\"]+)\"")
DOTTED = re.compile(r"`(facewright(?:\.[A-Za-z_]\w*)+)(?:\([^`]*\))?`")
COMMAND = re.compile(r"(?:^|[`$ ])facewright +([a-z]+)(?: +([a-z]+))?(?=[ `\n]|$)", re.MULTILINE)
HEADING = re.compile(r"^#+ +(.+?)\s*$", re.MULTILINE)
# Folders of one machine, and names of package registries other than a mention of the tools pip and conda.
FOREIGN_PATH = re.compile(r"(?<![\w.])/(?:home|root|work|Users|mnt|opt)/[\w.-]+")
REGISTRY = re.compile(
    r"https?://[\w.-]*(?:pypi|simple|registry|index|artifact|mirror|proxy)[\w.-]*|--(?:extra-)?index-url"
)


def pages() -> list[Path]:
    """Return all Markdown pages that the project ships."""
    shipped = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    if shipped.returncode == 0:
        return [ROOT / name for name in shipped.stdout.split() if (ROOT / name).is_file()]
    return [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]


def check_links(page: Path, text: str) -> list[str]:
    """Check that relative links and pictures exist, and that anchors are headings."""
    faults = []
    for match in LINK.finditer(CODE_BLOCK.sub("", text)):
        target = match[1] or match[2]
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists():
            faults.append(f"link to {target!r}, which does not exist")
        elif not file.is_relative_to(ROOT):
            faults.append(f"link to {target!r}, which leaves the repository")
        elif anchor and file.suffix == ".md" and anchor not in anchors(file.read_text(encoding="utf-8")):
            faults.append(f"link to {target!r}, but {file.name} has no such heading")
    return faults


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    found = set()
    for heading in HEADING.findall(CODE_BLOCK.sub("", text)):
        plain = re.sub(r"[`*_]|\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        found.add(re.sub(r"[^\w\- ]", "", plain).replace(" ", "-"))
    return found


def check_names(text: str) -> list[str]:
    """Check that every dotted name of the package that a page mentions can be imported."""
    faults = []
    for name in sorted(set(DOTTED.findall(text))):
        if not resolves(name):
            faults.append(f"names `{name}`, which does not exist")
    return faults


def resolves(name: str) -> bool:
    """Tell whether a dotted name is a module or an attribute of one."""
    parts = name.split(".")
    for split in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError as error:
            if error.name and not name.startswith(error.name):
                raise
            continue
        for attribute in parts[split:]:
            fields = getattr(found, "__dataclass_fields__", {})
            if not hasattr(found, attribute) and attribute not in fields:
                return False
            found = getattr(found, attribute, None)
        return True
    return False


def check_commands(text: str, verbs: dict[str, set[str]]) -> list[str]:
    """Check that every command shown exists."""
    faults = []
    code = "\n".join(re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL))
    for verb, child in COMMAND.findall(code):
        if verb not in verbs:
            faults.append(f"shows `facewright {verb}`, which is no command")
        elif verbs[verb] and child and child not in verbs[verb]:
            faults.append(f"shows `facewright {verb} {child}`, which is no command")
    return faults


def check_foreign(text: str) -> list[str]:
    """Check that nothing of one machine or one network stands in a page."""
    faults = [f"holds a path of one machine: {path}" for path in FOREIGN_PATH.findall(text)]
    return faults + [f"names a package registry: {name}" for name in REGISTRY.findall(text)]


def main() -> int:
    """Check all pages and print the faults."""
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import make_cli_docs

    verbs: dict[str, set[str]] = {}
    for name, _ in make_cli_docs.commands():
        _, verb, *child = name.split()
        verbs.setdefault(verb, set()).update(child)
    faults = []
    for page in pages():
        text = page.read_text(encoding="utf-8")
        found = check_links(page, text) + check_names(text) + check_commands(text, verbs) + check_foreign(text)
        faults += [f"{page.relative_to(ROOT)} {fault}" for fault in found]
    for folder in ("src", "examples", "benchmarks"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            found = check_foreign(file.read_text(encoding="utf-8"))
            faults += [f"{file.relative_to(ROOT)} {fault}" for fault in found]
    cli = ROOT / "docs" / "cli.md"
    if not cli.is_file() or cli.read_text(encoding="utf-8") != make_cli_docs.make_page():
        faults.append("docs/cli.md must match the commands: run tools/make_cli_docs.py")
    for constraints in sorted(ROOT.glob("constraints/*.txt")):
        lines = constraints.read_text(encoding="utf-8").splitlines()
        faults += [
            f"{constraints.relative_to(ROOT)} holds {line!r}, which is not name==version"
            for line in lines
            if not re.fullmatch(r"[\w.-]+==[\w.!+]+|#.*", line)
        ]
    for fault in faults:
        print(fault)
    print(f"docs: {len(faults)} faults" if faults else "docs: all pages hold")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
