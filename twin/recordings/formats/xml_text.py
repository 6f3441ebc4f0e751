"""XML: the root element tells the format. A DTD, an entity or an external reference is refused."""

from pathlib import Path

from twin.errors import InputError
from twin.recordings.formats import mtconnect, sinumerik
from twin.recordings.signals import ReadOptions, Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """The recording of an MTConnect or a SINUMERIK file; what is neither is no trace of a SINUMERIK."""
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    try:
        root = next(element.tag for _, element in iterparse(str(path), events=("start",), forbid_dtd=True))
        form = mtconnect if root.endswith("MTConnectStreams") else sinumerik
        return form.read(path, options)
    except DefusedXmlException as error:
        declared = type(error).__name__.replace("Forbidden", "").replace("Reference", " reference").lower()
        raise InputError(
            f"{path}: refused: the XML declares its own {declared or 'entities'}, which a trace never contains; export it again"
        ) from None
    except ParseError as error:
        raise InputError(f"{path}: not a complete XML file ({error}); it is cut off or damaged, export it again") from None
