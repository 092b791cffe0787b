#!/usr/bin/env python3
"""The tables of docs/measured/book.md: words and reading ease of the pages, and what fills them.

    tools/book_words.py df6ba14 HEAD            # prints the tables
    tools/book_words.py --write df6ba14 HEAD    # writes the page, and keeps its last section
    tools/book_words.py --ease                  # every page of this work tree, the hardest first

Words are counted as the test `pages_of_the_book_are_short` does, without generated parts. Reading
ease is Flesch's: 206.8 − 1.015 words a sentence − 84.6 syllables a word. It is that of sentences:
without code, tables, headings, addresses of links and generated parts. An item of a list ends a
sentence. Groups of vowels count as syllables. Standard library only.
"""
import argparse
import pathlib
import re
import subprocess
import textwrap

import page_figures

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/measured/book.md"
DOORS = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "RELEASING.md", "RELIABILITY.md", "SECURITY.md"]
READINGS = "## What the readings found"
LONG, WORST, FEWEST = 1_500, 10, 100
MARK = re.compile(r"\s*<!-- (api|figures:|benchmark:|cards|doors|keys|limits|metrics|paths|verbs|end of)")
SILENT = re.compile(r"(?<=[^aeiouyl])e$|(?<=[aeiouy]l)es?$|(?<=[^aeiouylscxzgh])es$|(?<=[^td])ed$")


def git(*arguments):
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout.decode()


def pages(commit):
    """Path and text of every page of a commit, or of the work tree."""
    paths = (git("ls-tree", "-r", "--name-only", commit) if commit else git("ls-files")).splitlines()
    paths = [path for path in paths if path in DOORS or re.match(r"docs/(?!SUMMARY\.md).*\.md$", path)]
    return {path: git("show", f"{commit}:{path}") if commit else (ROOT / path).read_text() for path in paths}


def written(text):
    """The lines outside of generated parts, by MARKS of documents.rs."""
    is_generated = False
    for line in text.splitlines():
        is_mark = MARK.match(line) is not None
        is_generated ^= is_mark
        if not is_generated and not is_mark:
            yield line


def words(text):
    return sum(any(map(str.isalnum, word)) for line in written(text) for word in line.split())


def sentences(text):
    """The sentences of a page, as lists of words."""
    text = "\n".join(written(text))
    text = re.sub(r"^( *)(`{3,}).*?^ *\2\s*$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!--.*?-->|<[a-z/][^>]*>", "", text, flags=re.DOTALL)
    text = re.sub(r"^\s*(#|\||>).*$|^\s*([-*]|\d+\.) ", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"!\[[^]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    # Code within a sentence counts as one short word.
    text = re.sub(r"`[^`]+`", "x", text)
    for sentence in re.split(r"\n\s*\n|(?<=[.!?])[*_)]*\s", text):
        if found := re.findall(r"[A-Za-zÀ-ÿ][A-Za-zÀ-ÿ'’-]*", sentence):
            yield found


def syllables(word):
    return max(1, len(re.findall(r"[aeiouy]+", SILENT.sub("", re.sub(r"[^a-z]", "", word.lower())))))


def eases(found):
    """Reading ease of each page with enough sentences, the hardest first."""
    rated = []
    for path, text in found.items():
        spoken = [word for sentence in sentences(text) for word in sentence]
        if (count := len(spoken)) >= FEWEST:
            rated.append((206.8 - 1.015 * count / len(list(sentences(text))) - 84.6 * sum(map(syllables, spoken)) / count, path))
    return sorted(rated)


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(f"{cell:,}" if isinstance(cell, int) else cell for cell in line) + " |" for line in lines)


def totals(found):
    counts = {path: words(text) for path, text in found.items()}
    docs = [count for path, count in counts.items() if path.startswith("docs/")]
    return [len(docs), sum(docs), round(sum(docs) / len(docs)), max(docs), sum(count > LONG for count in docs), *map(counts.get, DOORS)]


def sources():
    """Parts of pages that a test or a tool writes: page, part and writer."""
    yield "docs/reference/layout.md", "the page", "`JOULEBUS_WRITE=1 cargo test -p joulebus-c --test all layouts`"
    for file in git("grep", "-l", "assert_page_contains(", "--", "*.rs").splitlines():
        test, text = "", (ROOT / file).read_text()
        for named, page, part in re.findall(r'fn (\w+)\(|assert_page_contains\("(docs/[^"]+)", "<!-- ([^"]+)"', text):
            test = named or test
            if page:
                yield page, part, f"`{test}`"
    for path in git("ls-files", "docs/*.md").splitlines():
        text = (ROOT / path).read_text()
        for tool, kind, name in dict.fromkeys(re.findall(r"^<!-- (?:generated (?:in part )?by (tools/\w+\.py)|(figures|benchmark): (\w+) -->)", text, re.MULTILINE)):
            is_benchmark = kind == "benchmark" or name == "worth"
            folder = "docs/figures/campaigns" if (ROOT / f"docs/figures/campaigns/{name}.json").exists() else "docs/figures"
            file = "docs/measured/benchmark.csv" if is_benchmark else "configs/models" if name == "models" else f"{folder}/{name}.json"
            file = page_figures.WRITERS.get(name, file)
            yield path, name or "tables", f"`{tool or file}`"


def sections(commits, revisions):
    names = ["pages in `docs/`", "their words", "words a page", "words of the longest page", f"pages above {LONG:,} words", *DOORS]
    yield "## Words\nWords outside of generated parts.\n\n" + table(["", *commits], [list(row) for row in zip(names, *map(totals, revisions))])
    for commit, found in zip(commits, revisions):
        long = sorted(((count, path) for path, text in found.items() if (count := words(text)) > LONG), reverse=True)
        yield f"Pages above {LONG:,} words at {commit}:\n\n" + table(["page", "words"], [(path, count) for count, path in long])
    yield ("## Reading ease\nFlesch's reading ease of the sentences of a page. Higher is easier: 60 to 70 is called plain English. Pages with "
           f"fewer than {FEWEST} words in sentences have none.")
    for commit, rated in zip(commits, map(eases, revisions)):
        rows = [(path, f"{value:.0f}") for value, path in [*rated[:WORST], (rated[len(rated) // 2][0], f"*median of {len(rated)} pages*")]]
        yield f"The {WORST} hardest at {commit}:\n\n" + table(["page", "ease"], rows)
    title = lambda page: (ROOT / page).read_text().partition("\n")[0].removeprefix("# ")
    linked = [(f"[{title(page)}](../{page.removeprefix('docs/')})", *rest) for page, *rest in sorted(sources())]
    yield ("## Facts and their one source\nThese parts of pages are written from the sources. A test fails if they differ. "
           "`tools/page_figures.py` fills in figures.\n\n" + table(["page", "part", "test, tool or file that it comes from"], linked))


def wrapped(text):
    return "\n".join(line if line.startswith(("|", "#", "`")) else textwrap.fill(line, 100, break_on_hyphens=False) for line in text.splitlines())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commits", nargs="*", default=["HEAD"], metavar="COMMIT")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)}")
    parser.add_argument("--ease", action="store_true", help="reading ease of the pages of this work tree")
    given = parser.parse_args()
    if given.ease:
        return print("\n".join(f"{value:5.1f}  {path}" for value, path in eases(pages(None))))
    commits = [git("rev-parse", "--short=8", f"{commit}^{{commit}}").strip() for commit in given.commits]
    parts = list(sections(commits, [pages(commit) for commit in commits]))
    if not given.write:
        return print("\n\n".join(parts))
    kept = PAGE.read_text().partition(READINGS) if PAGE.exists() else ("", READINGS, "\n")
    told = " and ".join(f"{commit} ({git('show', '-s', '--format=%cs', commit).strip()})" for commit in commits)
    head = (f"# Words of the book\n\n<!-- generated by tools/book_words.py, except for the last section -->\n\nThis page compares the pages at "
            f"{told}.\n\n```sh\ntools/book_words.py --write {' '.join(given.commits)}\n```")
    PAGE.write_text("\n\n".join([*map(wrapped, [head, *parts]), READINGS]) + kept[2])


if __name__ == "__main__":
    main()
