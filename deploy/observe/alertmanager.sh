#!/bin/sh
# Writes the configuration of the Alertmanager from variables, and starts it. What a variable is not set for is left out;
# the log of alerts (deploy/observe/alert_log.py) hears everything, so that an alert is written down whatever is set:
#   ALERT_WEBHOOK_URL                       POSTs Alertmanager's JSON there
#   ALERT_SLACK_URL, ALERT_SLACK_CHANNEL    an incoming webhook of Slack, or of who speaks its language (Mattermost)
#   ALERT_MAIL_TO, ALERT_MAIL_FROM, ALERT_MAIL_HOST (name:port), ALERT_MAIL_USER, ALERT_MAIL_PASSWORD
#   ALERT_HEARTBEAT_URL                     asked every minute while alerts work: a service that calls when it hears nothing
# Usage: alertmanager.sh [--print]: the configuration alone
set -eu

quoted() { # a value as YAML's single quotes have it
    printf "'%s'" "$(printf %s "$1" | tr -d '\r\n' | sed "s/'/''/g")"
}

configuration() {
    cat <<EOF
route:
  receiver: people
  group_by: [alertname]
  group_wait: 30s
  group_interval: 5m
  repeat_interval: 4h
  routes:
    - matchers: [alertname = Heartbeat]
      receiver: heartbeat
      group_wait: 0s
      group_interval: 1m
      repeat_interval: 1m
inhibit_rules:
  # A gateway or a database that is away explains what it no longer does, and a page its own warning.
  - source_matchers: [alertname =~ "NoGateway|DatabaseIsAway|StoreIsAway", severity = page]
    target_matchers: [alertname =~ "GatewayIsNotReady|AnswersFail|JobsFail|JobsWait|FirstLookIsLate|OldestJobWaits|StoreIsSlow"]
  - source_matchers: [severity = page]
    target_matchers: [severity = warn]
    equal: [alertname, instance, objective]
receivers:
  - name: people
    webhook_configs:
      - url: ${ALERT_LOG_URL:-http://alert-log:9094/}
        send_resolved: true
EOF
    if [ -n "${ALERT_WEBHOOK_URL:-}" ]; then
        printf '      - url: %s\n        send_resolved: true\n' "$(quoted "$ALERT_WEBHOOK_URL")"
    fi
    if [ -n "${ALERT_SLACK_URL:-}" ]; then
        printf '    slack_configs:\n      - api_url: %s\n        channel: %s\n        send_resolved: true\n' \
            "$(quoted "$ALERT_SLACK_URL")" "$(quoted "${ALERT_SLACK_CHANNEL:-}")"
        cat <<'EOF'
        title: '{{ .Status }}: {{ .CommonLabels.alertname }}'
        text: '{{ range .Alerts }}{{ .Annotations.summary }} ({{ .Labels.severity }}; {{ .Annotations.runbook }}) {{ end }}'
EOF
    fi
    if [ -n "${ALERT_MAIL_TO:-}" ]; then
        printf '    email_configs:\n      - to: %s\n        from: %s\n        smarthost: %s\n        send_resolved: true\n' \
            "$(quoted "$ALERT_MAIL_TO")" "$(quoted "${ALERT_MAIL_FROM:-$ALERT_MAIL_TO}")" "$(quoted "${ALERT_MAIL_HOST:-}")"
        if [ -n "${ALERT_MAIL_USER:-}" ]; then
            printf '        auth_username: %s\n        auth_password: %s\n' \
                "$(quoted "$ALERT_MAIL_USER")" "$(quoted "${ALERT_MAIL_PASSWORD:-}")"
        fi
    fi
    printf '  - name: heartbeat\n'
    if [ -n "${ALERT_HEARTBEAT_URL:-}" ]; then
        printf '    webhook_configs:\n      - url: %s\n        send_resolved: false\n' "$(quoted "$ALERT_HEARTBEAT_URL")"
    fi
}

if [ "${1:-}" = --print ]; then
    configuration
    exit
fi
umask 077
configuration >/tmp/alertmanager.yml
exec alertmanager --config.file=/tmp/alertmanager.yml --storage.path=/alertmanager --cluster.listen-address= "$@"
