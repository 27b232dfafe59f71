"""Fields of dataclasses and settings in the reference: the comments behind them say shapes, units and meanings."""

import re

import griffe

COMMENT = re.compile(r"#\s*(?!noqa|fmt)(.+)$")


class FieldTables(griffe.Extension):
    """Appends to a class's docstring a table of those fields that have a comment."""

    def on_class_members(self, *, cls, agent, **_):
        if not cls.docstring or not isinstance(agent, griffe.Visitor):
            return
        lines, rows = cls.filepath.read_text(encoding="utf-8").splitlines(), []
        # griffe gives a class fields of its base too, whose lines are of another file
        own = lambda field: field.annotation is not None and (field.endlineno or 0) <= len(lines)
        for name, field in cls.attributes.items():
            found = own(field) and COMMENT.search(lines[field.endlineno - 1])
            if found:
                rows.append(f"| `{name}` | {found[1].replace('|', chr(92) + '|')} |")
        if rows:
            cls.docstring.value += "\n\n" + "\n".join(["| field | |", "|---|---|", *rows])
