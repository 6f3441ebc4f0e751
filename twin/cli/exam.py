"""`twin exam`: diagnose sealed campaigns, open the seals and score; with --plan, list the effects that a campaign can show."""

import hashlib
import json
from pathlib import Path

import twin
from twin.cli.arguments import Args, arg, count, flag, number, out_argument, seed
from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.files import output_folder, stamped, write_whole
from twin.units import in_words

ARGUMENTS = (
    arg("--seed", "N", "seed of the drawn machines (default: 0); use a fresh one for a published score", type=seed, default=0),
    arg("--cases", "N", "number of campaigns (default: 150)", type=number("1 to 100000", lambda v: 1 <= v <= 100_000, int), default=150),
    out_argument("folder for campaigns, answers, exam.json and report.html; continues an interrupted examination"),
    arg("--machine", "FILE", "machine file with the Mikron's five axes (default: the Mikron)"),
    ("--richness", {"choices": ("off", "small", "full"), "default": "small", "help": "imperfections that every axis has besides its faults (default: small); full: a diagnosis names them, and the marks count them as absent"}),
    ("--noise-keys", {"choices": ("given", "absent", "tenth", "tenfold"), "default": "given",
                      "help": "what the machine file says of noise and resolution: the truth (default), nothing, a tenth or ten times of it"}),
    flag("--quick", "diagnose as with 'twin diagnose --quick'"),
    arg("--only", "KIND", "only this kind of case, e.g. healthy, 'a fifth', outside"),
    flag("--short", "four runs per campaign instead of ten"),
    arg("--workers", "N", "number of processes (default: one per core)", type=count),
    arg("--scheduler", "ADDRESS", "Dask cluster that shares this file system, e.g. tcp://host:8786"),
    flag("--open", "open the seals now and score the answers so far"),
    arg("--plan", "CAMPAIGN", "no examination: list the effects that this campaign can show"),
)  # fmt: skip


def carry_out(args: Args) -> int:
    """Draw, seal, diagnose, open, mark and score. Returns 1 if a target is missed by more than chance."""
    if args.plan:
        from twin.exam.detectability import detectability_command

        return detectability_command(args)
    from twin.exam.mark import mark
    from twin.exam.questions import STRATA, questions_of
    from twin.exam.report import write_exam_report
    from twin.exam.score import is_failed, score
    from twin.exam.session import TRUTHS, draw, each, is_answered, processes, same_examination, seal, sit, sources, truths_text, unseal
    from twin.progress import Progress

    if args.only not in (None, *(kinds := [s.name for s in STRATA])):
        raise InputError(f"--only {args.only}: unknown kind of case; {nearest(args.only, kinds)}")
    machine_file, machine_name, machine_digest = _machine_of(args)
    out = output_folder(Path(args.out).resolve())
    questions = questions_of(args.seed, args.cases, args.short, args.only)
    options = {key: getattr(args, key) for key in ("seed", "cases", "short", "only", "richness", "quick", "noise_keys")}
    options["code"] = sources()
    same_examination(out, {**options, "machine": machine_digest})
    folders = {q.name: str(out / "cases" / q.name) for q in questions}
    with processes(args.scheduler, args.workers) as pool:
        with Progress("drawing cases", total=len(questions)) as bar:
            drawn = each(pool, draw, {q.name: (q, machine_file, args.richness) for q in questions}, bar)
        impossible = {name: reason for name, reason in drawn.items() if isinstance(reason, str)}
        cases = {name: case for name, case in drawn.items() if not isinstance(case, str)}
        text = truths_text(cases)
        digest = seal(text, out)
        print(f"{len(cases)} cases sealed, SHA-256 of the truths {digest}", flush=True)
        opened = args.open or (out / TRUTHS).exists()  # no diagnosis once the seals are open
        asked = [q for q in questions if q.name in cases and (not opened or is_answered(folders[q.name]))]
        if not asked:
            raise InputError(f"{out}: no case has been diagnosed yet; run it without --open first")
        with Progress("diagnosing", total=len(asked)) as bar:
            sat = {q.name: (q, cases[q.name], folders[q.name], machine_file, args.quick, args.noise_keys) for q in asked}
            seconds = each(pool, sit, sat, bar)
        unseal(text, out)
        print(f"opened: {out / TRUTHS}", flush=True)
        with Progress("marking", total=len(asked)) as bar:
            marks = each(pool, mark, {q.name: (q, cases[q.name], folders[q.name], machine_file) for q in asked}, bar)
    scored = score(list(marks.values()), laws_searched=not args.quick)
    took, left = {"diagnosis_median": sorted(seconds.values())[len(seconds) // 2]}, len(cases) - len(asked)
    document = {"twin": twin.__version__, **options, "machine": machine_name, "seal": digest, "not_drawn": impossible, "not_answered": left}
    document |= {"score": scored, "seconds": took, "marks": list(marks.values())}
    write_whole(out / "exam.json", json.dumps(stamped(document, "exam"), indent=1) + "\n")
    print(summary(document))
    write_exam_report(document, out / "report.html")
    print(f"written to {out}: exam.json, report.html, truths.json")
    return int(any(is_failed(t) for t in scored["targets"]))


def _machine_of(args: Args) -> tuple[str, str, str]:
    """(file, name, digest) of the machine; InputError if the second plant cannot be built from it."""
    from twin.exam.draw import what_lacks
    from twin.machine.machine import default_machine_path, load_machine

    file = Path(args.machine).resolve() if args.machine else default_machine_path()
    machine = load_machine(file)
    if machine.axis_names != ("X", "Y", "Z", "A", "C"):
        raise InputError(f"{file}: the examination's plant has the axes X, Y, Z, A, C; this file has {', '.join(machine.axis_names)}")
    table = read_toml(file)
    if (lack := what_lacks(table)) is not None:
        raise InputError(
            f"{file}: the examination's plant cannot be built from it ({lack}); give a file with the same entries as the Mikron's"
        )
    digest = hashlib.sha256(b"\0".join((file.read_bytes(), machine.model_path.read_bytes()))).hexdigest()[:16]
    return str(file), table.get("name", file.stem), digest


def summary(document: dict) -> str:
    """The score as a table for the terminal."""
    from twin.exam.report import counted, target_table
    from twin.simulation.summary import table

    s = document["score"]
    targets = target_table(s["targets"])
    strata = [[name, str(r["cases"]), *(str(r[k]) for k in ("first", "exact", "place"))] for name, r in s["strata"].items()]
    lines = [table(targets.heading, targets.rows, left=1), table(["stratum", "cases", "first", "exact", "axis and block"], strata, left=1)]
    lines.append(f"{counted(document)}; macro F1 {s['macro_f1']:.2f}; {s['failed']} could not be diagnosed")
    gap, same = s["gap"], s["same_parameters"]
    if gap["before"] is not None:
        shown = ", ".join(f"{in_words(k)} {gap[k]:.3g}" for k in gap if gap[k] and k != "unit")
        lines.append(f"gap over noise on the exam runs, medians: {shown}")
    if same["level"] is not None:
        lines.append(f"twin against plant with the same parameters and effects: {same['level']:.3g} times noise ({same['cases']} cases)")
    return "\n\n".join(lines)
