"""Words that no reader may meet: the project's own, for which the field has others."""

import re

PRIVATE = re.compile(
    r"\b(shadows?|news|bend|doubts?|chance|stands?|told|tells?|aside|apart|leans?|witness(es)?|near copies"
    r"|plausible|hollow|mend(s|ed)?|learned)\b|learned:"
)


def shown(page: str) -> str:
    """The text of an HTML page, of its figures too."""
    return re.sub(r"<[^>]*>", " ", re.sub(r"<style.*?</style>|<metadata.*?</metadata>", " ", page, flags=re.DOTALL))
