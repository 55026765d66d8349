{{- define "capture2vr.name" -}}
{{ printf "%s-capture2vr" .Release.Name | trunc 40 | trimSuffix "-" }}
{{- end }}

{{- define "capture2vr.labels" -}}
app.kubernetes.io/name: capture2vr
app.kubernetes.io/instance: {{ .Release.Name }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ .Chart.Name }}-{{ .Chart.Version }}
{{- end }}

{{- define "capture2vr.selector" -}}
app.kubernetes.io/name: capture2vr
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .component }}
{{- end }}

{{- define "capture2vr.image" -}}
{{- $named := print .root.Values.image.registry .image -}}
{{- if contains "@sha256:" .image -}}
{{ $named }}
{{- else -}}
{{ $named }}:{{ .root.Values.image.tag | default .root.Chart.AppVersion }}
{{- end -}}
{{- end }}

{{- define "capture2vr.pod" -}}
automountServiceAccountToken: false
enableServiceLinks: false  # else a release named gateway has variables that look like settings
{{- with .Values.serviceAccount }}
serviceAccountName: {{ . }}
{{- end }}
{{- with .Values.image.pullSecrets }}
imagePullSecrets:
  {{- range . }}
  - name: {{ . }}
  {{- end }}
{{- end }}
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  seccompProfile: {type: RuntimeDefault}
{{- end }}

{{- define "capture2vr.container" -}}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
{{- end }}

{{- /* The store's settings, alike for gateways, workers and the job that makes the bucket. */ -}}
{{- define "capture2vr.storage" -}}
- {name: STORAGE_KIND, value: s3}
- {name: STORAGE_BUCKET, value: {{ .Values.storage.bucket | quote }}}
- {name: STORAGE_REGION, value: {{ .Values.storage.region | quote }}}
- {name: STORAGE_COLLECTION, value: {{ .Values.storage.collection | quote }}}
- {name: STORAGE_PRESIGN_S, value: {{ .Values.storage.presignSeconds | quote }}}
{{- with include "capture2vr.endpoint" . }}
- {name: STORAGE_ENDPOINT, value: {{ . | quote }}}
{{- end }}
{{- with include "capture2vr.publicEndpoint" . }}
- {name: STORAGE_PUBLIC_ENDPOINT, value: {{ . | quote }}}
{{- end }}
{{- with .Values.storage.baseUrl }}
- {name: STORAGE_BASE_URL, value: {{ . | quote }}}
{{- end }}
{{- with .Values.storage.existingSecret }}
- name: STORAGE_ACCESS_KEY
  valueFrom: {secretKeyRef: {name: {{ . }}, key: access-key}}
- name: STORAGE_SECRET_KEY
  valueFrom: {secretKeyRef: {name: {{ . }}, key: secret-key}}
{{- end }}
{{- end }}

{{- define "capture2vr.endpoint" -}}
{{- if .Values.store.enabled -}}
http://{{ include "capture2vr.name" . }}-store:9000
{{- else -}}
{{ .Values.storage.endpoint }}
{{- end -}}
{{- end }}

{{- /* Whoever asks publicUrl for an object of the chart's own store gets it from there: ingress.yaml, gatewayapi.yaml. */ -}}
{{- define "capture2vr.publicEndpoint" -}}
{{- if and .Values.store.enabled (not .Values.storage.publicEndpoint) -}}
{{ trimSuffix "/" .Values.publicUrl }}
{{- else -}}
{{ .Values.storage.publicEndpoint }}
{{- end -}}
{{- end }}

{{- /* Paths of the store's objects that clients read, by URLs that the gateway has signed. */ -}}
{{- define "capture2vr.objectPaths" -}}
{{- if and .Values.store.enabled (not .Values.storage.publicEndpoint) -}}
{{- $bucket := .Values.storage.bucket -}}
{{ list (printf "/%s/assets/" $bucket) (printf "/%s/collections/" $bucket) (printf "/%s/tenants/" $bucket) | toJson }}
{{- else -}}
[]
{{- end -}}
{{- end }}

{{- define "capture2vr.signing" -}}
{{- if .Values.storage.signingKeySecret }}
- {name: STORAGE_SIGNING_KEY, value: /keys/signing/collection.key}
{{- end }}
{{- end }}

{{- define "capture2vr.keyMounts" -}}
{{- if .Values.storage.signingKeySecret }}
- {name: signing, mountPath: /keys/signing, readOnly: true}
{{- end }}
{{- if .Values.workerTls.existingSecret }}
- {name: worker-tls, mountPath: /keys/worker, readOnly: true}
{{- end }}
{{- end }}

{{- define "capture2vr.keyVolumes" -}}
{{- with .Values.storage.signingKeySecret }}
- name: signing
  secret: {secretName: {{ . }}, items: [{key: collection.key, path: collection.key}]}
{{- end }}
{{- end }}

{{- /* All pools of workers with workerDefaults filled in, as YAML. */ -}}
{{- define "capture2vr.pools" -}}
{{- range $pool, $worker := .Values.workers }}
{{ $pool }}: {{ mergeOverwrite (deepCopy $.Values.workerDefaults) ($worker | default dict) | toJson }}
{{- end }}
{{- end }}

{{- /* Thousandths of a CPU: 2, "2", 1.5, 500m. */ -}}
{{- define "capture2vr.milliCpu" -}}
{{- $text := toString . -}}
{{- if hasSuffix "m" $text -}}
{{ trimSuffix "m" $text | int }}
{{- else -}}
{{ mulf (float64 $text) 1000 | int }}
{{- end -}}
{{- end }}

{{- /* Threads of a job: the CPUs that a worker may use, else those that it is sure of, by slots. Without it each job starts a thread for
every core of the node. OpenBLAS, MKL and PyTorch follow it too. */ -}}
{{- define "capture2vr.threads" -}}
{{- $cpu := get (.resources.limits | default dict) "cpu" | default (get (.resources.requests | default dict) "cpu") -}}
{{- if $cpu -}}
{{ div (include "capture2vr.milliCpu" $cpu | int) (mul 1000 .slots) | max 1 }}
{{- end -}}
{{- end }}

{{- define "capture2vr.pool" -}}
{{ include "capture2vr.name" .root }}-{{ .pool }}
{{- end }}
