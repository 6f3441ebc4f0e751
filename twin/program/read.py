"""Read a program in any format. The content selects the reader; the file ending decides if the content is ambiguous."""

from pathlib import Path
import re

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.program.apt import AptReader
from twin.program.build import Collector
from twin.program.expressions import WordError
from twin.program.iso import execute
from twin.program.iso_blocks import LINUXCNC, Iso
from twin.program.klartext import KLARTEXT, KLARTEXT_M
from twin.program.klartext_blocks import Klartext
from twin.program.moves import Program, place_of
from twin.program.reader import Reader
from twin.program.sinumerik import SINUMERIK_NAMES, carry_out
from twin.program.sinumerik_blocks import Sinumerik
from twin.program.source import ProgramText, units_of

SINUMERIK_ENDINGS = (".mpf", ".spf")
APT = (".apt", ".cls", ".cl", ".aptsource", ".ncl", ".cldata", ".cld")
_OF_ISO = ".ngc .nc .iso .tap .cnc .gcode .gc .g .ncc .eia .min .ncd .nci .pim .prg .dnc .fnc"
PROGRAM_ENDINGS = (*SINUMERIK_ENDINGS, *_OF_ISO.split(), *APT)
"""Common file endings of part programs; `read_program` accepts any."""

AMBIGUOUS = ("", ".txt", ".h")
"""Endings of programs and of other files: the text decides."""
_BLOCK = re.compile(
    r"\s*(?:[%(;]|[O:]\d+\s*$|/?\s*(?:N\d+\s*)?[GMTSFXYZABCR]\s*[-+.=\d#\[]|\d*\s*(?:BEGIN PGM|TOOL CALL|L |CC? |CYCL |LBL |BLK FORM))",
    re.I | re.A,
)


def is_program(path: Path) -> bool:
    """Whether a file is a part program, by its ending, or by its first lines where the ending does not decide."""
    if path.suffix.lower() in PROGRAM_ENDINGS:
        return True
    if path.suffix.lower() not in AMBIGUOUS or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(4000)
    if b"BEGIN PGM" in head.upper():
        return True
    lines = [line for line in head.decode("latin-1").splitlines()[:40] if line.strip()]
    return b"\0" not in head and 2 * sum(bool(_BLOCK.match(line)) for line in lines) > len(lines)


SNIFFED_LINES = 3000
_SINUMERIK = re.compile(
    r"^\s*%_N_|^\s*;\s*\$PATH|\bM?CALL\s+CYCLE\d|\bCYCLE\d{2,4}\s*\(|\bTRAORI\b|\bA?TRANS\b|\bSUPA\b|\bMSG\s*\(|\b[XYZ]\s*=|=\s*(?:IC|AC|DC)\s*\(|"
    r"\bT\s*=\s*\"|\bR\d+\s*=|\bCR\s*=|^\s*(?:N\d+\s*)?DEF\s+(?:REAL|INT|BOOL|STRING)|\bGOTO[FB]\b|^\s*PROC\b|\bFFWON\b|\bCOMPCAD\b|\$P_|\bMCALL\b",
    re.M | re.I,
)
_APT = re.compile(r"^\s*(?:PARTNO|TOOL PATH/|GOTO\s*/|FEDRAT\s*/|LOADTL\s*/|MULTAX|SPINDL\s*/|CUTTER\s*/|FROM\s*/|UNITS\s*/|\$\$)", re.M)
_ISO_MARKS = re.compile(r"^\s*[O:]\d{2,}|\bG43\s*H|#\d+\s*=|#<|\bM98\s*P|\bG9[89]\b|\bG8[1-9]\b|\bO<|\bG5[4-9]\.1", re.M | re.I)
_KLARTEXT = re.compile(r"^\s*\d*\s*BEGIN\s+PGM\b", re.M)
DIN_ISO = "a HEIDENHAIN program in DIN/ISO"
_OTHER = (
    (re.compile(r"^%\s*\S+\s+G7[01]\b", re.M), DIN_ISO),
    (re.compile(r"^\$\S+%\s*$|^\s*(?:N\d+\s*)?(?:CALL\s+O[A-Z0-9]+|V[CS]\d+\s*=|RTS\s*$)", re.M), "an OKUMA OSP program"),
    (re.compile(r"^\s*(?:%L\s+\w+|#VAR\b|\$(?:IF|FOR|WHILE|SWITCH)\b)|\bV\.[LGPE]\.\w", re.M), "an ISG or Beckhoff program"),
    (re.compile(r"^\s*%@MACRO\b|^\s*[@#]\d+\s*:=", re.M | re.I), "a SYNTEC macro"),
    (re.compile(r"^%[\w .-]*,M", re.M), "a FAGOR program"),
    (re.compile(r"^\s*(?:sub|gosub)\s+[a-z_]\w*\s*(?:;.*)?$", re.M | re.I), "an Eding CNC program"),
    (re.compile(r"^\s*(?:N\d+\s*)?@\d{2,3}\s+[KRP]", re.M), "a SINUMERIK 810 or 840C program"),
    (re.compile(r"^\s*(?:MODULE\s+\w|PROC\s+main\(\)|MoveL\s|&ACCESS\b)", re.M), "a robot program"),
    (re.compile(r"^\s*(?:<\?xml|<html|\{\s*\")", re.I), "no part program but a data file"),
    (re.compile(r"^\s*(?:ISO-10303-21|solid\s+\w)", re.I), "a model, not a program"),
    (re.compile(r"^%\d", re.M), re.compile(r"\bG7[79]\s*[HN]|\bER-?\d|\bG0*[01]\s+G52\s*[XYZ]"), "a NUM program"),
    (re.compile(r"^\s*M1(?:04|09|40)\s+S\d", re.M), re.compile(r"^\s*G[01]\b[^\n;]*\bE-?[\d.]", re.M), "a program of a 3-D printer"),
    (
        re.compile(r"\b[XYZ][-+\d.]+[ \t]+(?:F[\d.]+[ \t]+)?M9[12]\b", re.M),
        re.compile(r"^\s*(?:N\d+\s*)?I[+-][\d.]+\s*J[+-][\d.]+\s*\*?\s*$|\bM13\b|\bG98\s*L\d|\bD0?0\s*Q\d", re.M),
        DIN_ISO,
    ),
    # a length of the tool that is called without G43
    (
        re.compile(r"^[ \t]*(?:N\d+[ \t]*)?(?:G90[ \t]*)?H\d+[ \t]+Z[-\d.]+[ \t]*$", re.M),
        re.compile(r"\A(?!(?s:.*)G43)(?s:.*)\bE\d\b"),
        "a FADAL program",
    ),
)
"""Languages that are not read, by one mark or by several together."""


def dialect(source: ProgramText) -> str:
    """Language of a program: 'sinumerik', 'linuxcnc', 'iso', 'klartext' or 'apt'.

    Raises:
        InputError: it is in another language, which is named.
    """
    ending = source.path.suffix.lower()
    text = "\n".join(source.lines[:SNIFFED_LINES])
    found = [name for *marks, name in _OTHER if all(mark.search(text) for mark in marks)]
    if ending == ".h" or _KLARTEXT.search(text):
        return "klartext"
    if found:
        raise InputError(f"{source.path}: this is {found[0]}, which is not read; post the program as SINUMERIK, ISO or APT")
    if ending in SINUMERIK_ENDINGS:
        return "sinumerik"
    if ending in APT:
        return "apt"
    code = re.sub(r"\([^()\n]*\)", "()", text)
    if ending == ".ngc" or LINUXCNC.search(code):
        return "linuxcnc"
    sinumerik = len(_SINUMERIK.findall(re.sub(r";(?!\s*\$PATH).*", "", code)))
    if len(_APT.findall(text)) > 2 and not re.search(r"^\s*N?\d*\s*G0?[01]\b", text, re.M):
        return "apt"
    if ending not in (".iso",) and sinumerik > len(_ISO_MARKS.findall(code)):
        return "sinumerik"
    return "iso"


def understand(program: str | Path | ProgramText, machine: Machine) -> Collector:
    """The moves of a program, or of one whose lines are read already; not yet checked against the machine."""
    source = program if isinstance(program, ProgramText) else ProgramText(Path(program))
    path, language = source.path, dialect(source)
    front: Reader | AptReader
    if language == "apt":
        front = AptReader(source, machine)
    elif language == "klartext":
        front = Klartext(path, machine, units_of(source)[0], KLARTEXT, KLARTEXT_M)
    elif language == "sinumerik":
        front = Sinumerik(path, machine, units_of(source), SINUMERIK_NAMES, carry_out)
    else:
        front = Iso(path, machine, units_of(source)[0], execute, linuxcnc=language == "linuxcnc")
    where = path
    try:
        front.run()
        return front.out
    except WordError as error:
        where, text, column = front.reading, str(error), error.column
    except ArithmeticError:
        text, column = "a number of this block is out of range; correct it", 0
    except RecursionError:
        text, column = "calls or brackets are nested too deeply; take some apart", 0
    raise InputError(f"{place_of(where, front.state.line, front.state.block, column)}: {text}")


def read_program(path: str | Path, machine: Machine) -> Program:
    """Read a part program: SINUMERIK or ISO G-code, or APT/CL; every fault is an InputError with line and column."""
    return understand(path, machine).finish()
