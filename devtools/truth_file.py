"""A truth as TOML text, in the form of the truth.toml of recorded campaigns."""

from __future__ import annotations


def truth_toml(truth: dict) -> str:
    """The truth of a case (`twin.exam.draw.truth_of`) as TOML text."""

    def value(v: object) -> str:
        if isinstance(v, bool):
            return str(v).lower()
        return f'"{v}"' if isinstance(v, str) else repr(v) if isinstance(v, int) else f"{v:.9g}"

    def table(head: str, entries: dict) -> str:
        return "\n".join([head, *(f"{k} = {value(v)}" for k, v in entries.items()), ""])

    parts = [table("[case]", truth["case"])]
    parts += [table(f"[[{kind}]]", e) for kind in ("effect", "outside") for e in truth[kind]] or ["# no effect\n"]
    parts += [table("[[budget]]", row) for row in truth.get("budget", ())]
    parts += [table(f"[parameter.{name}]", t) for name, t in truth["parameter"].items()]
    return "\n".join(parts)
