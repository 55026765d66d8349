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
{{ .root.Values.image.registry }}{{ .image }}:{{ .root.Values.image.tag | default .root.Chart.AppVersion }}
{{- end }}

{{- define "capture2vr.pod" -}}
automountServiceAccountToken: false
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
{{- with .Values.storage.endpoint }}
- {name: STORAGE_ENDPOINT, value: {{ . | quote }}}
{{- end }}
{{- with .Values.storage.publicEndpoint }}
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

{{- define "capture2vr.pool" -}}
{{ include "capture2vr.name" .root }}-{{ .pool }}
{{- end }}
