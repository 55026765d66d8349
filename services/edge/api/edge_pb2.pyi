from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Stage(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STAGE_UNSPECIFIED: _ClassVar[Stage]
    VALIDATING: _ClassVar[Stage]
    ALIGNING: _ClassVar[Stage]
    POINT_CLOUD: _ClassVar[Stage]
    FITTING: _ClassVar[Stage]
    EXTRACTING: _ClassVar[Stage]
    TEXTURING: _ClassVar[Stage]
    PACKING: _ClassVar[Stage]
    PUBLISHING: _ClassVar[Stage]
STAGE_UNSPECIFIED: Stage
VALIDATING: Stage
ALIGNING: Stage
POINT_CLOUD: Stage
FITTING: Stage
EXTRACTING: Stage
TEXTURING: Stage
PACKING: Stage
PUBLISHING: Stage

class Chunk(_message.Message):
    __slots__ = ("header", "data", "trailer")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    TRAILER_FIELD_NUMBER: _ClassVar[int]
    header: Header
    data: Data
    trailer: Trailer
    def __init__(self, header: _Optional[_Union[Header, _Mapping]] = ..., data: _Optional[_Union[Data, _Mapping]] = ..., trailer: _Optional[_Union[Trailer, _Mapping]] = ...) -> None: ...

class Header(_message.Message):
    __slots__ = ("job", "fence", "preset", "asset_key", "target", "capture_bytes", "label", "longest_m", "prepared", "collection", "fill", "box", "cut", "tenant", "token", "visibility", "capture", "description", "labels", "edits", "publish_anyway", "most_seconds", "columns", "unit")
    JOB_FIELD_NUMBER: _ClassVar[int]
    FENCE_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    ASSET_KEY_FIELD_NUMBER: _ClassVar[int]
    TARGET_FIELD_NUMBER: _ClassVar[int]
    CAPTURE_BYTES_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    LONGEST_M_FIELD_NUMBER: _ClassVar[int]
    PREPARED_FIELD_NUMBER: _ClassVar[int]
    COLLECTION_FIELD_NUMBER: _ClassVar[int]
    FILL_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    CUT_FIELD_NUMBER: _ClassVar[int]
    TENANT_FIELD_NUMBER: _ClassVar[int]
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    VISIBILITY_FIELD_NUMBER: _ClassVar[int]
    CAPTURE_FIELD_NUMBER: _ClassVar[int]
    DESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    LABELS_FIELD_NUMBER: _ClassVar[int]
    EDITS_FIELD_NUMBER: _ClassVar[int]
    PUBLISH_ANYWAY_FIELD_NUMBER: _ClassVar[int]
    MOST_SECONDS_FIELD_NUMBER: _ClassVar[int]
    COLUMNS_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    job: str
    fence: int
    preset: str
    asset_key: str
    target: str
    capture_bytes: int
    label: str
    longest_m: float
    prepared: bool
    collection: str
    fill: str
    box: Box
    cut: str
    tenant: str
    token: str
    visibility: str
    capture: str
    description: str
    labels: _containers.RepeatedScalarFieldContainer[str]
    edits: str
    publish_anyway: bool
    most_seconds: float
    columns: str
    unit: str
    def __init__(self, job: _Optional[str] = ..., fence: _Optional[int] = ..., preset: _Optional[str] = ..., asset_key: _Optional[str] = ..., target: _Optional[str] = ..., capture_bytes: _Optional[int] = ..., label: _Optional[str] = ..., longest_m: _Optional[float] = ..., prepared: _Optional[bool] = ..., collection: _Optional[str] = ..., fill: _Optional[str] = ..., box: _Optional[_Union[Box, _Mapping]] = ..., cut: _Optional[str] = ..., tenant: _Optional[str] = ..., token: _Optional[str] = ..., visibility: _Optional[str] = ..., capture: _Optional[str] = ..., description: _Optional[str] = ..., labels: _Optional[_Iterable[str]] = ..., edits: _Optional[str] = ..., publish_anyway: _Optional[bool] = ..., most_seconds: _Optional[float] = ..., columns: _Optional[str] = ..., unit: _Optional[str] = ...) -> None: ...

class Box(_message.Message):
    __slots__ = ("left", "top", "right", "bottom", "photo")
    LEFT_FIELD_NUMBER: _ClassVar[int]
    TOP_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    BOTTOM_FIELD_NUMBER: _ClassVar[int]
    PHOTO_FIELD_NUMBER: _ClassVar[int]
    left: float
    top: float
    right: float
    bottom: float
    photo: str
    def __init__(self, left: _Optional[float] = ..., top: _Optional[float] = ..., right: _Optional[float] = ..., bottom: _Optional[float] = ..., photo: _Optional[str] = ...) -> None: ...

class Data(_message.Message):
    __slots__ = ("offset", "data")
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    offset: int
    data: bytes
    def __init__(self, offset: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class Trailer(_message.Message):
    __slots__ = ("sha256",)
    SHA256_FIELD_NUMBER: _ClassVar[int]
    sha256: bytes
    def __init__(self, sha256: _Optional[bytes] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("job", "seq", "elapsed_s", "progress", "heartbeat", "published", "failure", "finished", "anchors")
    JOB_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_S_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    FINISHED_FIELD_NUMBER: _ClassVar[int]
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    job: str
    seq: int
    elapsed_s: float
    progress: Progress
    heartbeat: Heartbeat
    published: Published
    failure: Failure
    finished: Finished
    anchors: AnchorPoints
    def __init__(self, job: _Optional[str] = ..., seq: _Optional[int] = ..., elapsed_s: _Optional[float] = ..., progress: _Optional[_Union[Progress, _Mapping]] = ..., heartbeat: _Optional[_Union[Heartbeat, _Mapping]] = ..., published: _Optional[_Union[Published, _Mapping]] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., finished: _Optional[_Union[Finished, _Mapping]] = ..., anchors: _Optional[_Union[AnchorPoints, _Mapping]] = ...) -> None: ...

class Progress(_message.Message):
    __slots__ = ("stage", "fraction", "losses", "eta_s", "message", "i18n")
    class LossesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    STAGE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    LOSSES_FIELD_NUMBER: _ClassVar[int]
    ETA_S_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    I18N_FIELD_NUMBER: _ClassVar[int]
    stage: Stage
    fraction: float
    losses: _containers.ScalarMap[str, float]
    eta_s: float
    message: str
    i18n: str
    def __init__(self, stage: _Optional[_Union[Stage, str]] = ..., fraction: _Optional[float] = ..., losses: _Optional[_Mapping[str, float]] = ..., eta_s: _Optional[float] = ..., message: _Optional[str] = ..., i18n: _Optional[str] = ...) -> None: ...

class Heartbeat(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class AnchorPoints(_message.Message):
    __slots__ = ("xyz_m", "rgb")
    XYZ_M_FIELD_NUMBER: _ClassVar[int]
    RGB_FIELD_NUMBER: _ClassVar[int]
    xyz_m: _containers.RepeatedScalarFieldContainer[float]
    rgb: bytes
    def __init__(self, xyz_m: _Optional[_Iterable[float]] = ..., rgb: _Optional[bytes] = ...) -> None: ...

class Published(_message.Message):
    __slots__ = ("asset_key", "version", "state", "manifest", "collection", "grade", "held")
    ASSET_KEY_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    MANIFEST_FIELD_NUMBER: _ClassVar[int]
    COLLECTION_FIELD_NUMBER: _ClassVar[int]
    GRADE_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    asset_key: str
    version: int
    state: str
    manifest: str
    collection: str
    grade: Grade
    held: bool
    def __init__(self, asset_key: _Optional[str] = ..., version: _Optional[int] = ..., state: _Optional[str] = ..., manifest: _Optional[str] = ..., collection: _Optional[str] = ..., grade: _Optional[_Union[Grade, _Mapping]] = ..., held: _Optional[bool] = ...) -> None: ...

class Grade(_message.Message):
    __slots__ = ("level", "because", "advice", "i18n")
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    BECAUSE_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    I18N_FIELD_NUMBER: _ClassVar[int]
    level: str
    because: str
    advice: str
    i18n: str
    def __init__(self, level: _Optional[str] = ..., because: _Optional[str] = ..., advice: _Optional[str] = ..., i18n: _Optional[str] = ...) -> None: ...

class Failure(_message.Message):
    __slots__ = ("code", "message", "file", "hints", "retryable", "stage", "i18n")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    HINTS_FIELD_NUMBER: _ClassVar[int]
    RETRYABLE_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    I18N_FIELD_NUMBER: _ClassVar[int]
    code: str
    message: str
    file: str
    hints: _containers.RepeatedScalarFieldContainer[str]
    retryable: bool
    stage: Stage
    i18n: str
    def __init__(self, code: _Optional[str] = ..., message: _Optional[str] = ..., file: _Optional[str] = ..., hints: _Optional[_Iterable[str]] = ..., retryable: _Optional[bool] = ..., stage: _Optional[_Union[Stage, str]] = ..., i18n: _Optional[str] = ...) -> None: ...

class Finished(_message.Message):
    __slots__ = ("warnings", "seconds", "i18n")
    class SecondsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    I18N_FIELD_NUMBER: _ClassVar[int]
    warnings: _containers.RepeatedScalarFieldContainer[str]
    seconds: _containers.ScalarMap[str, float]
    i18n: str
    def __init__(self, warnings: _Optional[_Iterable[str]] = ..., seconds: _Optional[_Mapping[str, float]] = ..., i18n: _Optional[str] = ...) -> None: ...

class Inspection(_message.Message):
    __slots__ = ("kind", "format", "frames", "points", "warnings", "failure", "outline", "i18n", "processor_s")
    KIND_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    OUTLINE_FIELD_NUMBER: _ClassVar[int]
    I18N_FIELD_NUMBER: _ClassVar[int]
    PROCESSOR_S_FIELD_NUMBER: _ClassVar[int]
    kind: str
    format: str
    frames: int
    points: int
    warnings: _containers.RepeatedScalarFieldContainer[str]
    failure: Failure
    outline: _containers.RepeatedCompositeFieldContainer[Polygon]
    i18n: str
    processor_s: float
    def __init__(self, kind: _Optional[str] = ..., format: _Optional[str] = ..., frames: _Optional[int] = ..., points: _Optional[int] = ..., warnings: _Optional[_Iterable[str]] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., outline: _Optional[_Iterable[_Union[Polygon, _Mapping]]] = ..., i18n: _Optional[str] = ..., processor_s: _Optional[float] = ...) -> None: ...

class Polygon(_message.Message):
    __slots__ = ("xy",)
    XY_FIELD_NUMBER: _ClassVar[int]
    xy: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, xy: _Optional[_Iterable[float]] = ...) -> None: ...

class AttachRequest(_message.Message):
    __slots__ = ("job", "after_seq", "token")
    JOB_FIELD_NUMBER: _ClassVar[int]
    AFTER_SEQ_FIELD_NUMBER: _ClassVar[int]
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    job: str
    after_seq: int
    token: str
    def __init__(self, job: _Optional[str] = ..., after_seq: _Optional[int] = ..., token: _Optional[str] = ...) -> None: ...

class CancelRequest(_message.Message):
    __slots__ = ("job", "token")
    JOB_FIELD_NUMBER: _ClassVar[int]
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    job: str
    token: str
    def __init__(self, job: _Optional[str] = ..., token: _Optional[str] = ...) -> None: ...

class CancelReply(_message.Message):
    __slots__ = ("was_running",)
    WAS_RUNNING_FIELD_NUMBER: _ClassVar[int]
    was_running: bool
    def __init__(self, was_running: _Optional[bool] = ...) -> None: ...

class YieldRequest(_message.Message):
    __slots__ = ("job", "token")
    JOB_FIELD_NUMBER: _ClassVar[int]
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    job: str
    token: str
    def __init__(self, job: _Optional[str] = ..., token: _Optional[str] = ...) -> None: ...

class YieldReply(_message.Message):
    __slots__ = ("yields",)
    YIELDS_FIELD_NUMBER: _ClassVar[int]
    yields: bool
    def __init__(self, yields: _Optional[bool] = ...) -> None: ...

class GetWorkerRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Worker(_message.Message):
    __slots__ = ("version", "device", "presets", "slots", "free_slots", "queued", "draining", "jobs", "memory_bytes", "points_version", "central")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    PRESETS_FIELD_NUMBER: _ClassVar[int]
    SLOTS_FIELD_NUMBER: _ClassVar[int]
    FREE_SLOTS_FIELD_NUMBER: _ClassVar[int]
    QUEUED_FIELD_NUMBER: _ClassVar[int]
    DRAINING_FIELD_NUMBER: _ClassVar[int]
    JOBS_FIELD_NUMBER: _ClassVar[int]
    MEMORY_BYTES_FIELD_NUMBER: _ClassVar[int]
    POINTS_VERSION_FIELD_NUMBER: _ClassVar[int]
    CENTRAL_FIELD_NUMBER: _ClassVar[int]
    version: str
    device: str
    presets: _containers.RepeatedCompositeFieldContainer[Preset]
    slots: int
    free_slots: int
    queued: int
    draining: bool
    jobs: _containers.RepeatedScalarFieldContainer[str]
    memory_bytes: int
    points_version: int
    central: str
    def __init__(self, version: _Optional[str] = ..., device: _Optional[str] = ..., presets: _Optional[_Iterable[_Union[Preset, _Mapping]]] = ..., slots: _Optional[int] = ..., free_slots: _Optional[int] = ..., queued: _Optional[int] = ..., draining: _Optional[bool] = ..., jobs: _Optional[_Iterable[str]] = ..., memory_bytes: _Optional[int] = ..., points_version: _Optional[int] = ..., central: _Optional[str] = ...) -> None: ...

class Preset(_message.Message):
    __slots__ = ("name", "summary", "trained", "memory_bytes", "literature", "takes", "i18n")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    TRAINED_FIELD_NUMBER: _ClassVar[int]
    MEMORY_BYTES_FIELD_NUMBER: _ClassVar[int]
    LITERATURE_FIELD_NUMBER: _ClassVar[int]
    TAKES_FIELD_NUMBER: _ClassVar[int]
    I18N_FIELD_NUMBER: _ClassVar[int]
    name: str
    summary: str
    trained: bool
    memory_bytes: int
    literature: bool
    takes: str
    i18n: str
    def __init__(self, name: _Optional[str] = ..., summary: _Optional[str] = ..., trained: _Optional[bool] = ..., memory_bytes: _Optional[int] = ..., literature: _Optional[bool] = ..., takes: _Optional[str] = ..., i18n: _Optional[str] = ...) -> None: ...

class DownloadRequest(_message.Message):
    __slots__ = ("tenant", "asset_key", "manifest", "format")
    TENANT_FIELD_NUMBER: _ClassVar[int]
    ASSET_KEY_FIELD_NUMBER: _ClassVar[int]
    MANIFEST_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    tenant: str
    asset_key: str
    manifest: str
    format: str
    def __init__(self, tenant: _Optional[str] = ..., asset_key: _Optional[str] = ..., manifest: _Optional[str] = ..., format: _Optional[str] = ...) -> None: ...

class Download(_message.Message):
    __slots__ = ("name", "bytes", "failure")
    NAME_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    name: str
    bytes: int
    failure: Failure
    def __init__(self, name: _Optional[str] = ..., bytes: _Optional[int] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ...) -> None: ...
