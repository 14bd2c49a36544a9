{{- define "residuum.labels" -}}
app.kubernetes.io/name: residuum
app.kubernetes.io/instance: {{ .Release.Name }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
{{- end }}

{{- define "residuum.selector" -}}
app.kubernetes.io/name: residuum
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "residuum.image" -}}
{{ .Values.image.repository }}:{{ .Values.image.tag | default .Chart.AppVersion }}
{{- end }}

{{- define "residuum.podSecurity" -}}
runAsNonRoot: true
runAsUser: 10001
runAsGroup: 10001
fsGroup: 10001
seccompProfile: {type: RuntimeDefault}
{{- end }}

{{- define "residuum.containerSecurity" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: {drop: [ALL]}
{{- end }}

{{- define "residuum.environment" -}}
- {name: RESIDUUM_SETTINGS, value: /etc/residuum/settings.yaml}
- {name: RESIDUUM_API_KEYS, value: /var/lib/residuum-keys/api_keys}
- {name: RESIDUUM_DATA, value: /var/lib/residuum}
- {name: RESIDUUM_LOG_FORMAT, value: json}
- {name: RESIDUUM_CACHE, value: /var/cache/residuum}
- {name: NUMBA_CACHE_DIR, value: /var/cache/residuum}
{{- with .Values.database.existingSecret }}
- name: RESIDUUM_DATABASE
  valueFrom: {secretKeyRef: {name: {{ . }}, key: url}}
{{- end }}
{{- with .Values.mqtt.existingSecret }}
- name: RESIDUUM_MQTT
  valueFrom: {secretKeyRef: {name: {{ . }}, key: url}}
{{- end }}
{{- end }}

{{- define "residuum.mounts" -}}
- {name: data, mountPath: /var/lib/residuum}
- {name: settings, mountPath: /etc/residuum, readOnly: true}
- {name: maps, mountPath: /etc/residuum-maps, readOnly: true}
- {name: keys, mountPath: /var/lib/residuum-keys, readOnly: true}
- {name: tmp, mountPath: /tmp}
- {name: code, mountPath: /var/cache/residuum, subPath: residuum}
{{- end }}

{{- /* An emptyDir is open to everybody, and no compiled code is kept below such a folder: a folder of this user's own is made in
it first, and that alone is mounted. */}}
{{- define "residuum.codeFolder" -}}
- name: code-folder
  image: {{ include "residuum.image" . }}
  imagePullPolicy: {{ .Values.image.pullPolicy }}
  args: ["install", "-d", "-m", "0700", "/code/residuum"]
  securityContext:
    {{- include "residuum.containerSecurity" . | nindent 4 }}
  resources:
    {{- toYaml .Values.resources | nindent 4 }}
  volumeMounts:
    - {name: code, mountPath: /code}
{{- end }}

{{- define "residuum.volumes" -}}
- name: data
  persistentVolumeClaim: {claimName: {{ .Release.Name }}-data}
- name: settings
  configMap: {name: {{ .Release.Name }}-settings}
- name: maps
  configMap: {name: {{ .Release.Name }}-maps}
- name: keys
  secret: {secretName: {{ .Values.apiKeys.existingSecret }}}
- name: tmp
  emptyDir: {}
- name: code
  emptyDir: {}
{{- end }}

{{- define "residuum.settingsMark" -}}
checksum/settings: {{ include (print $.Template.BasePath "/settings.yaml") . | sha256sum }}
{{- end }}

{{- define "residuum.placement" -}}
{{- with .Values.nodeSelector }}
nodeSelector:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .Values.tolerations }}
tolerations:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- end }}
