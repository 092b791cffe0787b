#!/usr/bin/env bash
# A fleet's own authority, and a certificate for each of its hosts: `tools/fleet_certificates.sh DIR
# NAME=ADDRESS…`, where NAME is that of the host's link and ADDRESS the host name or IP address that
# others connect to. The authority's key is made once and used again. Keep it off the hosts.
set -euo pipefail
umask 077
[ $# -ge 2 ] || { sed -n '2,4s/^# //p' "$0" >&2; exit 2; }
mkdir -p "$1"
cd "$1"
shift
days=${JOULEBUS_CERTIFICATE_DAYS:-825}
if [ ! -e fleet-ca.key ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 3650 -subj "/CN=joulebus fleet" \
        -addext basicConstraints=critical,CA:TRUE -addext keyUsage=critical,keyCertSign \
        -keyout fleet-ca.key -out fleet-ca.pem 2>/dev/null
fi
for host in "$@"; do
    name=${host%%=*} address=${host#*=}
    case $address in
        *[!0-9.]*) kind=DNS ;;
        *) kind=IP ;;
    esac
    case $address in *:*) kind=IP ;; esac
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj "/CN=$name" \
        -keyout "$name.key" -out "$name.csr" 2>/dev/null
    openssl x509 -req -in "$name.csr" -CA fleet-ca.pem -CAkey fleet-ca.key -CAcreateserial -days "$days" \
        -extfile <(printf 'subjectAltName=%s:%s\nextendedKeyUsage=serverAuth,clientAuth\n' "$kind" "$address") \
        -out "$name.pem" 2>/dev/null
    rm "$name.csr"
    echo "$PWD/$name.pem"
done
