"""Elements of a piece of HTML, for assertions."""

from html.parser import HTMLParser

VOID = {"img", "br", "meta", "wbr", "link", "input"}


class Elements(HTMLParser):
    """The elements of a piece of HTML with their attributes, and its texts. Asserts that elements nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def count(self, tag: str) -> int:
        """Number of elements of a kind."""
        return sum(found == tag for found, _ in self.found)

    def attributes(self, tag: str, **wanted: str) -> dict[str, str | None]:
        """The attributes of the first such element."""
        return next(own for found, own in self.found if found == tag and wanted.items() <= own.items())
