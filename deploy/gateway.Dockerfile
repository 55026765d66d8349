ARG PYTHON_IMAGE=python:3.11-slim
FROM ${PYTHON_IMAGE} AS build
# For slim.sh, at whatever version the base image's Debian has; it stays in this stage.
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends binutils && rm -rf /var/lib/apt/lists/*
WORKDIR /src
# All that is installed is known by hash (deploy/lock.sh), what builds the product's wheel included.
COPY deploy/locks/build.txt deploy/locks/gateway.txt ./
RUN python -m venv /build && /build/bin/pip install --no-cache-dir --no-deps --require-hashes -r build.txt && \
    python -m venv /venv && /venv/bin/pip install --no-cache-dir --no-deps --require-hashes -r gateway.txt
COPY pyproject.toml README.md LICENSE ./
COPY services ./services
RUN /build/bin/pip wheel --no-deps --no-build-isolation -w /wheels . && \
    /venv/bin/pip install --no-cache-dir --no-index --no-deps /wheels/*.whl && /venv/bin/pip check
# In a folder of its own: what is checked is what was installed, not the sources.
WORKDIR /slim
COPY deploy/slim.sh deploy/check_image.py ./
RUN sh slim.sh /venv && \
    /venv/bin/python check_image.py gateway

FROM ${PYTHON_IMAGE}
RUN useradd --system --uid 10001 --create-home capture2vr
COPY --from=build /venv /venv
# The standard library comes without bytecode, and these files are read-only once the container runs.
RUN /venv/bin/python -c "import capture2vr.gateway.__main__, capture2vr.storage.bucket, psycopg, urllib.request"
# The jobs' database and the staging of uploads: a volume; the rest runs read-only. In /secret compose keeps the store's.
RUN mkdir -p /data /secret && chown capture2vr /data /secret
VOLUME /data
ENV PATH=/venv/bin:$PATH PYTHONUNBUFFERED=1 GATEWAY_HOST=0.0.0.0 GATEWAY_PORT=8080 GATEWAY_DATA_DIR=/data
USER 10001
EXPOSE 8080
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=3s --timeout=10s --start-period=60s CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8080/livez', timeout=9)"]
ENTRYPOINT ["capture2vr"]
CMD ["gateway"]
