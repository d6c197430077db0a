"""The inputs of a run: everything that it was computed from, stored with it.

    inputs.json = {"files": [{"what", "path", "sha256", "bytes"}, ..], "texts": {sha256: text, ..}}

Population, irregularity and effect files and each campaign.toml are stored as text, records by their hash alone.  run.toml holds
the rest: limits, rule and the population with its defaults.  A run that is resumed uses these copies.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec
from msgspec import Struct

from pipeline.errors import ConfigError, GyroscreenError, IntegrityError
from pipeline.store.files import file_sha256, sha256
from pipeline.toml_files import decode
from populations.extend import chain
from populations.spec import spec_from_toml

from ..config import RunConfig
from .campaign_source import FILE as CAMPAIGN
from .settings import lot_population, lot_source, population, spec_path

FILE = "inputs.json"
_MOST_TEXT = 1 << 20
_SHOWN = 5
_CODE = ("effect", "irregularity")


class InputFile(Struct, frozen=True):
    """A file: "population", "irregularity", "effect", "campaign" or "record"; its absolute path, SHA-256 and size.

    ``sha256`` is empty where the file could not be read.
    """

    what: str
    path: str
    sha256: str
    bytes: int

    def now(self) -> str:
        """SHA-256 of the file as it is now."""
        return _file(self.what, Path(self.path), {}).sha256


class Inputs(Struct, frozen=True):
    """All files, and the text of those that are stored, by SHA-256."""

    files: tuple[InputFile, ...] = ()
    texts: dict[str, str] = {}

    def text(self, file: InputFile) -> str | None:
        """The stored content of a file, or ``None``."""
        return self.texts.get(file.sha256)

    def of(self, *what: str) -> tuple[InputFile, ...]:
        """The files of these kinds."""
        return tuple(file for file in self.files if file.what in what)

    def changed(self) -> tuple[InputFile, ...]:
        """The files that are no longer what they were."""
        return tuple(file for file in self.files if file.now() != file.sha256)

    def to_json(self) -> bytes:
        """Content of inputs.json."""
        return msgspec.json.encode(self)


class _RecordFile(Struct):
    file: str | list[str] = ""

    @property
    def files(self) -> list[str]:
        return [self.file] if isinstance(self.file, str) else self.file


class _Records(Struct):
    record: list[_RecordFile] = []


def _file(what: str, path: Path, texts: dict[str, str]) -> InputFile:
    """``path`` with its hash; its text goes to ``texts`` unless it is a record, too large or no text."""
    digest, size = file_sha256(path)
    if digest and what != "record" and size <= _MOST_TEXT:
        with suppress(OSError, UnicodeDecodeError):
            data = path.read_bytes()  # once: a file that changes in between would be stored under the hash of another
            digest, size = sha256(data), len(data)
            texts[digest] = data.decode()
    return InputFile(what, str(path.absolute()), digest, size)


def _code(folders: Iterable[str]) -> list[Path]:
    return [path for folder in folders for path in sorted(Path(folder).glob("*.py"))]


def collected(config: RunConfig, campaigns: Sequence[Path]) -> Inputs:
    """The inputs of a run with this configuration on the campaigns in these folders (none: a population), but for records."""
    texts: dict[str, str] = {}
    wanted = [("effect", path) for path in _code(config.effect_folders)]
    if config.source.kind == "population":
        wanted += [("population", path) for path in chain(spec_path(config.source))]
        wanted += [("irregularity", path) for path in _code(population(config).irregularity_folders)]
    elif config.lot_origin.enabled:
        wanted += [("population", path) for path in chain(spec_path(lot_source(config)))]
        wanted += [("irregularity", path) for path in _code(lot_population(config).irregularity_folders)]
    wanted += [("campaign", folder / CAMPAIGN) for folder in campaigns]
    return Inputs(tuple(_file(what, path, texts) for what, path in wanted), texts)


def with_records(inputs: Inputs) -> Inputs:
    """``inputs`` with the hashes of the records that the campaigns name."""
    campaigns = inputs.of("campaign")
    paths = (path for file in campaigns for path in record_paths(file, inputs.text(file)))
    records = [_file("record", Path(path), {}) for path in paths]
    return Inputs((*inputs.files, *records), inputs.texts)


def record_paths(campaign: InputFile, text: str | None) -> list[str]:
    """Absolute paths of the records that the campaign.toml ``campaign`` with this text names."""
    folder = Path(campaign.path).parent
    try:
        named = decode((text or "").encode(), _Records, CAMPAIGN).record
    except GyroscreenError:  # the row of this device states the reason
        return []
    return [str((folder / name).absolute()) for entry in named for name in entry.files if name]


def read_inputs(data: bytes, where: str) -> Inputs:
    """The inputs that a run stored; IntegrityError where ``data`` is not inputs.json."""
    try:
        return msgspec.json.decode(data, type=Inputs)
    except msgspec.DecodeError as error:
        raise IntegrityError(f"{where} cannot be read ({error})", next_step="run `gyroscreen verify`") from None


def check_copies(inputs: Inputs, changed: Sequence[InputFile]) -> None:
    """Check that the run holds a copy of every file that has changed; of records it holds none.

    Raises
    ------
    ConfigError : a record has changed or is missing.
    """
    lost = [file for file in changed if inputs.text(file) is None]
    if lost:
        shown = [
            f"{file.path}: sha256 {file.sha256[:12]} -> {file.now()[:12] or 'unreadable'}" for file in lost[:_SHOWN]
        ]
        raise ConfigError(
            f"{len(lost)} files have changed since the run started ({'; '.join(shown)})",
            allowed="the records that the run was started with",
            next_step="restore them, or start a new run",
        )


def with_stored_code(config: RunConfig, inputs: Inputs) -> RunConfig:
    """``config`` with the run's own effects and irregularities where the user's files have changed.

    The copies are written to a temporary folder that lives as long as the process.
    """
    return _moved(config, {folder: _unpacked(folder, inputs)[0] for folder in _changed_folders(config, inputs)})


def with_own_code(config: RunConfig, inputs: Inputs) -> tuple[RunConfig, dict[str, str], dict[str, str]]:
    """``config`` with copies of all of the user's effects and irregularities, the copies (path -> text), copy -> folder.

    A worker that starts hours later would otherwise load what the user has changed since: half of a night would have had
    another effect than the rest.
    """
    folders = dict.fromkeys(str(Path(one.path).parent) for one in inputs.of(*_CODE))
    unpacked = {folder: _unpacked(folder, inputs) for folder in folders}
    texts = {path: text for _, own in unpacked.values() for path, text in own.items()}
    moved = {folder: copy for folder, (copy, _) in unpacked.items()}
    return _moved(config, moved), texts, {copy: folder for folder, copy in moved.items()}


@contextmanager
def faults_in_the_users_folder(folders: Mapping[str, str]) -> Iterator[None]:
    """Errors of the user's code name the user's file, not its copy; ``folders``: copy -> folder."""
    try:
        yield
    except ConfigError as error:
        what = error.what
        for copy, folder in folders.items():
            what = what.replace(copy, folder)
        if what == error.what:
            raise
        raise ConfigError(what, value=error.value, allowed=error.allowed, next_step=error.next_step) from error


def _moved(config: RunConfig, moved: Mapping[str, str]) -> RunConfig:
    """``config`` with the copies ``moved`` (folder -> copy) in the place of the user's folders."""
    if not moved:
        return config
    source = config.source
    if source.spec_toml is not None:
        text = source.spec_toml
        for folder, copy in moved.items():
            text = text.replace(msgspec.json.encode(folder).decode(), msgspec.json.encode(copy).decode())
        source = msgspec.structs.replace(source, spec_toml=text)
    folders = tuple(moved.get(folder, folder) for folder in config.effect_folders)
    return msgspec.structs.replace(config, source=source, effect_folders=folders)


def _changed_folders(config: RunConfig, inputs: Inputs) -> list[str]:
    """Folders with code whose files are not those that the run was started with."""
    stored = inputs.of(*_CODE)
    changed = []
    for folder in dict.fromkeys((*config.effect_folders, *(str(Path(file.path).parent) for file in stored))):
        before = {file.path: file.sha256 for file in stored if str(Path(file.path).parent) == folder}
        if before and before != {file.path: file.sha256 for file in (_file("effect", p, {}) for p in _code([folder]))}:
            changed.append(folder)
    return changed


def _unpacked(folder: str, inputs: Inputs) -> tuple[str, dict[str, str]]:
    """A copy of the code of ``folder``, which lives as long as the process, and its files (path -> text)."""
    copy = Path(tempfile.mkdtemp(prefix="gyroscreen-inputs-"))
    atexit.register(shutil.rmtree, copy, ignore_errors=True)
    texts = {
        str(copy / Path(file.path).name): text
        for file in inputs.of(*_CODE)
        if str(Path(file.path).parent) == folder and (text := inputs.text(file)) is not None
    }
    for path, text in texts.items():
        Path(path).write_bytes(text.encode())
    return str(copy), texts


def differences(stored: RunConfig, wanted: RunConfig) -> list[str]:
    """The keys in which two configurations differ, each with both values; the number of workers does not count."""
    return [f"{name}: {before!r} -> {after!r}" for name, before, after in changed_keys(stored, wanted)]


def changed_keys(stored: RunConfig, wanted: RunConfig) -> list[tuple[str, object, object]]:
    """The same as (key, value before, value after); ``None`` where a configuration lacks the key."""
    before, after = (dict(_flat(config)) for config in (stored, wanted))
    names = sorted(before.keys() | after.keys())
    return [(name, before.get(name), after.get(name)) for name in names if before.get(name) != after.get(name)]


def _flat(config: RunConfig) -> Iterator[tuple[str, object]]:
    plain = msgspec.to_builtins(config)
    plain["run"].pop("workers")
    text, compared = plain["source"].pop("spec_toml"), plain["lot_origin"].pop("population_toml")
    if text is not None:
        plain["population"] = msgspec.to_builtins(spec_from_toml(text, "population of the run"))
    if compared is not None:
        plain["lot_origin"]["spec"] = msgspec.to_builtins(spec_from_toml(compared, "population of [lot_origin]"))
    yield from _leaves("", plain)


def _leaves(prefix: str, value: object) -> Iterator[tuple[str, object]]:
    if isinstance(value, dict) and value:
        for name, one in value.items():
            yield from _leaves(f"{prefix}.{name}" if prefix else str(name), one)
    else:
        yield prefix, value
