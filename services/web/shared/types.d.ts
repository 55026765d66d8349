// Shapes of what the server sends and takes, one for each document. Only `make lint` reads this file; no page loads it.
// The sources: services/gateway/schemas.py (jobs, presets, problems), services/storage/catalogue (entries, collections) and
// services/edge/asset/manifest.py (manifests).

/** Width, height and depth in metres. */
export type SizeM = [width: number, height: number, depth: number];

// ---- access ---------------------------------------------------------------------------------------------------------

export type Scope = 'capture' | 'read' | 'manage' | 'operate';

/** Who makes the requests of this browser: GET /v1/session. `key`: id of the access key. */
export interface Session {
  tenant: string;
  scopes: Scope[];
  via: 'open' | 'key' | 'session' | 'anonymous';
  key: string;
}

/** An invitation of a device: GET /v1/pairings/{pairing}. */
export interface Pairing {
  id: string;
  label: string;
  expires: string;
  claimed: boolean;
}

/** What POST /v1/pairings answers: `qr` is an SVG document that shows `url`. */
export interface NewPairing extends Pairing {
  code: string;
  url: string;
  qr: string;
}

/** A share link: one of GET /v1/shares. `opened`: how often; `ended`: "", revoked or expired. */
export interface Share {
  id: string;
  mode: 'read' | 'place';
  has_password: boolean;
  expires: string | null;
  ended: string;
  opened: number;
  url: string;
}

/** GET /v1/shares. `next`: the value of `after` for the next page. */
export interface SharePage {
  shares: Share[];
  next: string | null;
}

/** What a share link opens: POST /v1/shares/open. `view`: path of its page. */
export interface OpenedShare {
  view: string;
}

/** A format for other programs. `bytes`: of the file, where it has been made before. */
export interface Download {
  format: string;
  title: string;
  about: string;
  file: string;
  bytes: number | null;
  url: string;
}

/** GET /v1/assets/{key}/downloads */
export interface DownloadList {
  downloads: Download[];
}

// ---- assets ---------------------------------------------------------------------------------------------------------

export type AssetState = 'preview' | 'refined';

/** A file of an asset. `file`: its name in the asset; `name`: its name in the store; `sha256`: of its bytes, hexadecimal. */
export interface AssetFile {
  file: string;
  name: string;
  url: string;
  sha256: string;
}

/** A level of detail. `level`: 0 is the finest. */
export interface LodFile extends AssetFile {
  level: number;
  triangles: number;
}

/** A version of an asset. `job`: id of the job that made it, "" without one; `restored`: the version that it has the files of. */
export interface VersionRecord {
  version: number;
  state: AssetState;
  job: string;
  created: string;
  restored?: number;
  held?: boolean;
}

export type GradeLevel = 'good' | 'usable' | 'incomplete' | 'shoot again';

/** How good a version is. `because`, `advice`: '' for a good one. */
export interface Grade {
  level: GradeLevel;
  because: string;
  advice: string;
}

/** The catalogue entry of an asset: GET /v1/assets/{key}. */
export interface AssetEntry {
  key: string;
  version: number;
  state: AssetState;
  label?: string;
  description?: string;
  labels?: string[] | null;
  origin?: 'measured' | 'guess' | 'generated';
  scale_confidence: string;
  size_m: SizeM;
  lods: LodFile[];
  files?: AssetFile[];
  manifest: AssetFile;
  preview?: { url: string };
  collections?: string[];
  visibility?: Visibility | null;
  effective_visibility?: Visibility;
  may_place?: boolean;
  proof?: SignedEnvelope | null;
  versions?: VersionRecord[];
  capture_to_asset?: number[] | null;
}

/** PATCH /v1/assets/{key}: what people call a thing. */
export interface AssetNames {
  key: string;
  label: string;
  description: string;
  labels: string[];
}

/** A note: one of GET /v1/assets/{key}/notes. `at` is in the asset frame of the version `frame`. */
export interface Note {
  id: string;
  text: string;
  at: Triple;
  normal: Triple | null;
  author: string;
  created: string;
  edited: string;
  version: number;
  frame: number;
}

/** GET /v1/assets/{key}/notes. `version`: the newest. */
export interface NoteList {
  version: number;
  notes: Note[];
}

/** Who may read a thing besides its tenant. */
export type Visibility = 'private' | 'unlisted' | 'public';

/** What the `signed` text of an entry's `proof` says. `manifest`: its sha256. */
export interface AssetProof {
  asset: string;
  version: number;
  manifest: string;
}

/** Figures of a manifest's certificate. A manifest from an older worker has fewer. */
export interface QualityFigures {
  held_out?: number;
  held_out_mean?: number;
  points_to_mesh_median?: number;
  coverage?: number;
  components?: number;
  boundary_loops?: number;
  non_manifold_edges?: number;
  triangles?: number;
  steps?: number;
  seconds?: number;
  verdict?: 'better' | 'even' | 'worse';
  photos?: { cover: number } | null;
  origins?: { measured: number; proposed: number; filled: number };
}

/** A value of a sentence: a text, a number, or a sentence with its English. */
export type SentenceValue = string | number | (SentenceCode & { text?: string }) | SentenceValue[];

/** What a sentence beside it is made from, whatever its language. */
export interface SentenceCode {
  code: string;
  values: Record<string, SentenceValue>;
}

/** Whether a photo was used. `verdict`: "ok", or why it was left out. */
export interface PhotoVerdict {
  name: string;
  verdict: string;
  advice: string;
  advice_i18n?: SentenceCode;
}

/** What was captured. `unseen`: sides of the object that it shows too little of. */
export interface CaptureSummary {
  kind?: 'points' | 'rgbd' | 'photos' | 'image';
  format?: string;
  frames?: number;
  photos?: PhotoVerdict[];
  unseen?: { advice: string; advice_i18n?: SentenceCode }[];
  cut?: CutReport | null;
  up?: { source: string; confidence: number } | null;
}

/** What was kept of a capture, and why. */
export interface CutReport {
  kept: 'object' | 'scene';
  because: string;
  because_i18n?: SentenceCode;
}

/** A few coloured points that are shown until the mesh is loaded: flat lists of metres and of sRGB bytes. */
export interface AnchorPoints {
  xyz_m: number[];
  rgb: number[];
}

/** The manifest of one version. A refined version's `quality.preview` has the figures of the preview that it replaced. */
export interface Manifest {
  origin?: 'measured' | 'guess' | 'generated';
  capture?: CaptureSummary;
  quality?: QualityFigures & { preview?: QualityFigures };
  anchors?: AnchorPoints;
  scale_by_model?: boolean;
  edits?: Edits;
  warnings?: string[];
  warnings_i18n?: (SentenceCode | null)[];
  preset?: string;
  preset_because?: string;
  preset_because_i18n?: SentenceCode;
  target?: string;
  generator?: string;
  files: AssetFile[];
}

// ---- scenes ---------------------------------------------------------------------------------------------------------

/** Where an asset stands in a scene. `position_m`: in the scene's frame; `rotation`: a unit quaternion x, y, z, w. */
export interface Pose {
  position_m: number[];
  rotation: number[];
  scale: number;
}

/** An asset in a scene. `id`: within the scene. */
export interface PlacedAsset extends Pose {
  id: string;
  asset: string;
}

/** The event `moving` of GET /v1/scenes/{scene}/events. `sender`: as the page that moves the thing calls itself. */
export interface MovingEvent extends Pose {
  sender: string;
  id: string;
}

/** A scene: GET /v1/scenes/{scene}. `may_save`: whether the caller may replace it. */
export interface SceneDocument {
  id: string;
  name: string;
  version: number;
  items: PlacedAsset[];
  view: string;
  may_place: boolean;
  may_save: boolean;
}

/** GET /v1/scenes. `next`: the value of `after` for the next page. */
export interface ScenePage {
  scenes: { id: string; name: string; things: number; view: string }[];
  next: string | null;
}

/** An asset that a search of a collection has found. `preview`: URL of a picture, or "". */
export interface FoundAsset {
  key: string;
  label: string;
  labels: string[];
  preview: string;
}

/** GET /v1/collections/{name}/assets. `next`: the value of `after` for the next page. */
export interface FoundAssets {
  assets: FoundAsset[];
  next: string | null;
}

// ---- edits (docs/edits.md) ------------------------------------------------------------------------------------------

/** A place or a direction in the capture frame. */
export type Triple = [x: number, y: number, z: number];

/** A box outside of which points are cut away. `rotation`: a unit quaternion x, y, z, w. */
export interface CropBox {
  centre: Triple;
  size: Triple;
  rotation?: [x: number, y: number, z: number, w: number];
}

/** A plane behind which points are cut away: the normal is to the side that is kept. */
export interface CutPlane {
  point: Triple;
  normal: Triple;
}

/** Two points and the metres between them. */
export interface MeasuredLength {
  start: Triple;
  end: Triple;
  metres: number;
}

/** A closed line in a photo of the capture, around what is left out, or kept. `line`: corners as shares of its sides. */
export interface PhotoLasso {
  photo: string;
  line: [x: number, y: number][];
  keeps?: boolean;
  through?: boolean;
}

/** A recipe: GET /v1/schemas/edits. */
export interface Edits {
  schema?: 1;
  capture?: string;
  crop?: CropBox | null;
  planes?: CutPlane[];
  lassos?: PhotoLasso[];
  up?: Triple | null;
  front?: Triple | null;
  length?: MeasuredLength | null;
  cut?: string;
  fill?: string;
  preset?: string;
  target?: string;
}

// ---- collections (docs/catalogues.md) -------------------------------------------------------------------------------

/** A public key: `key` is its id, `ed25519` the key itself in base64. */
export interface PublicKey {
  key: string;
  ed25519: string;
}

/** A collection's index with its signatures: GET /v1/collections/{name}. `signed` is JSON, a CollectionIndex. */
export interface SignedEnvelope {
  signed: string;
  signatures: { key: string; ed25519: string }[];
  base: string;
}

/** A shard of a collection, or a node with further parts: `count` rows, with keys from `first` on. `name`: of its object. */
export interface CataloguePart {
  name: string;
  sha256: string;
  bytes: number;
  count: number;
  first: string;
}

/** What is signed: a tree, whose `children` are shards where its `depth` is 0; without `children` all shards are listed. */
export interface CollectionIndex extends Partial<NodeDocument> {
  collection: string;
  version: number;
  depth?: number;
  count?: number;
  shards?: Record<string, unknown>[];
}

/** A node's file: a row for each child. A child's `sha256` is in base64url without padding. */
export interface NodeDocument {
  columns: string[];
  children: unknown[][];
}

/** A collection as the pages use it. `base`: the address below which all of its objects are; `count`: of its rows. */
export interface Collection {
  name: string;
  version: number;
  parts: CataloguePart[];
  depth: number;
  count: number;
  base: string;
}

/** A shard's file. `labels` and `state` of a row are places in `words`. */
export interface ShardDocument {
  columns: string[];
  words: string[];
  rows: unknown[][];
}

/** An asset in a collection. `manifest`: its sha256 in base64url without padding. */
export interface CollectionRow {
  key: string;
  label: string;
  labels: string[];
  version: number;
  state: AssetState | 'removed';
  updated: number;
  manifest: string;
  bytes: number;
  grade: string;
}

// ---- jobs -----------------------------------------------------------------------------------------------------------

/** A problem document (RFC 9457): `detail` is for people, `code` for programs. */
export interface ProblemDocument {
  code?: string;
  title?: string;
  detail?: string;
  status?: number;
  file?: string;
  hints?: string[];
}

/** What was stored of an upload: POST /v1/captures. `verdict`: "ok", or why a file was left out; `stripped`: metadata that were removed from it. */
export interface CaptureReceipt {
  capture: string;
  files?: { file: string; verdict: string; stripped?: string[] }[];
}

/** What to keep of a capture: the object without its surroundings, everything, or the object if photos were taken around one. */
export type Cut = 'auto' | 'object' | 'scene';

/** A job to start: POST /v1/jobs. */
export interface JobRequest {
  capture: string;
  asset_key: string;
  label: string;
  description: string;
  labels: string[];
  collection: string;
  target: string;
  preset: string;
  cut: Cut;
  longest_m: number | null;
  fill: string;
  box: [left: number, top: number, right: number, bottom: number, photo?: string] | null;
  visibility: Visibility | '';
}

/** The thing in a photo: POST /v1/outlines. Closed lines of corners, as shares of the upright photo's sides. */
export interface PhotoOutline {
  outline: [x: number, y: number][][];
  warnings: string[];
}

export interface Presets {
  presets: { name: string; summary: string; literature: boolean; takes: string }[];
  default: string;
}

export type JobState = 'QUEUED' | 'RUNNING' | 'CANCELLING' | 'SUCCEEDED' | 'FAILED' | 'CANCELLED';

/** How far a job is: part of a job, and an event of its stream. `losses`: of the training, by their names. */
export interface JobProgress {
  stage: string;
  fraction?: number;
  eta_s?: number;
  message?: string;
  message_i18n?: SentenceCode;
  losses?: { total?: number };
}

/** The event of a job whose points are there, and whose mesh is not. */
export interface AnchorsEvent {
  anchors: AnchorPoints;
}

/** A version that a job has published. */
export interface PublishedVersion {
  key: string;
  version: number;
  state: AssetState;
  grade?: Grade | null;
  held?: boolean;
}

/** A question that a capture leaves open: one of a job's warnings, with answers. An option "" is for a person to fill in. */
export interface Question {
  code: string;
  text: string;
  text_i18n?: SentenceCode;
  answers: { text: string; options: Record<string, string> }[];
}

/** A job: GET /v1/jobs/{id}. */
export interface Job extends JobProgress {
  id: string;
  state: JobState;
  asset_key: string;
  preview: PublishedVersion | null;
  asset: PublishedVersion | null;
  error: ProblemDocument | null;
  warnings: string[];
  questions?: Question[];
  capture: string;
  label: string;
  edits?: Edits;
  links: { again: string };
}

/** A tenant: GET /v1/tenants. */
export interface Tenant {
  name: string;
  label: string;
  created: string;
}

/** Limits of a tenant; 0 is no limit. */
export interface Limits {
  requests_per_minute: number;
  uploads_at_once: number;
  jobs_at_once: number;
  jobs_per_day: number;
  stored_bytes: number;
  capture_bytes: number;
}

/** What a tenant uses: GET /v1/tenants/{name}/usage. */
export interface Usage {
  tenant: string;
  limits: Limits;
  own_limits: Partial<Limits>; // set for this tenant alone
  jobs: number;
  jobs_today: number;
  stored_bytes: number;
}

/** An access key, without its secret: GET /v1/api-keys. */
export interface AccessKey {
  id: string;
  tenant: string;
  label: string;
  scopes: Scope[];
  created: string;
  expires: string | null;
  last_used: string | null;
  revoked: string | null;
}

/** A request that changed something: GET /v1/audit. */
export interface AuditRecord {
  id: number;
  at: string;
  tenant: string;
  via: string;
  key: string;
  address: string;
  method: string;
  path: string;
  status: number;
}

/** A worker that answers, in GET /v1/service. */
export interface WorkerState {
  address: string;
  version: string;
  device: string;
  slots: number;
  free_slots: number;
  queued: number;
  draining: boolean;
  memory_bytes: number;
  compatible: boolean;
}

/** State of the service: GET /v1/service. */
export interface Service {
  version: string;
  open: boolean;
  ready: boolean;
  checks: Record<string, { ok: boolean; detail: string }>;
  jobs: Record<string, number>;
  waiting_s: number;
  workers: WorkerState[];
  silent_workers: string[];
  disks: { holds: string; free_bytes: number; total_bytes: number }[];
  failures: { job: string; tenant: string; asset_key: string; at: string; code: string; detail: string }[];
}
