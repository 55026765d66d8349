ARG PYTHON_IMAGE=python:3.11-slim
FROM ${PYTHON_IMAGE} AS build
# The extra "fast" is built from source. The compiler stays in this stage, at whatever version the base image's Debian has.
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /src
# All that is installed is known by hash (deploy/lock.sh), what builds wheels included: so no build fetches tools by itself.
COPY constraints.txt deploy/locks/build.txt deploy/locks/edge.txt deploy/locks/cuda.txt ./
RUN python -m venv /build && /build/bin/pip install --no-cache-dir --no-deps --require-hashes -r build.txt
# PyTorch's CPU build, a tenth of the size of the CUDA build, lies in an index of its own. It is taken by its version, not by a
# hash. Empty (--build-arg TORCH_INDEX=) leaves pip's own index, whose build for Linux is the one with CUDA, by hash.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
# First and alone, from that index alone: where it cannot be reached, pip would go on with the CUDA build after minutes of retries.
RUN if [ -n "$TORCH_INDEX" ]; then \
      /build/bin/pip wheel --no-cache-dir --retries 1 --timeout 60 --no-deps -w /wheels -c constraints.txt --index-url "$TORCH_INDEX" torch || \
      { echo "PyTorch cannot be had from TORCH_INDEX=$TORCH_INDEX: name a mirror of it (docker compose: TORCH_CPU_INDEX), or" \
             "leave it empty for pip's own index, whose PyTorch brings 2.3 GB of CUDA" >&2; exit 1; }; \
    else \
      /build/bin/pip wheel --no-cache-dir --no-deps -w /wheels --require-hashes -r cuda.txt; \
    fi
RUN /build/bin/pip wheel --no-cache-dir --no-deps --no-build-isolation -w /wheels --require-hashes -r edge.txt
COPY pyproject.toml README.md LICENSE ./
COPY services ./services
# Further extras, with a comma between them: --build-arg EXTRAS=ray for EDGE_ENGINE=ray://head:10001. By version, not by hash.
ARG EXTRAS=
RUN /build/bin/pip wheel --no-deps --no-build-isolation -w /wheels . && python -m venv /venv && \
    /venv/bin/pip install --no-cache-dir --no-index --no-deps /wheels/*.whl && /venv/bin/pip check && \
    if [ -n "$EXTRAS" ]; then /venv/bin/pip install --no-cache-dir -c constraints.txt "$(echo /wheels/capture2vr-*.whl)[$EXTRAS]"; fi
# In a folder of its own: what is checked is what was installed, not the sources.
WORKDIR /slim
COPY deploy/slim.sh deploy/check_image.py ./
# The pages are the gateway's alone.
RUN sh slim.sh /venv && rm -r /venv/lib/python3*/site-packages/capture2vr/web && \
    /venv/bin/python check_image.py edge

FROM ${PYTHON_IMAGE}
RUN useradd --system --uid 10001 --create-home capture2vr
COPY --from=build /venv /venv
# The standard library comes without bytecode, and these files are read-only once the container runs.
RUN /venv/bin/python -c "import capture2vr.edge.__main__, capture2vr.edge.worker.health, torch"
# Scratch is the only thing written, checkpoints included: mount a disk here that outlives the container.
RUN mkdir -p /scratch && chown capture2vr /scratch
ENV PATH=/venv/bin:$PATH PYTHONUNBUFFERED=1 EDGE_HOST=0.0.0.0 EDGE_PORT=50051 EDGE_SCRATCH=/scratch
USER 10001
EXPOSE 50051
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=5s --timeout=10s --start-period=60s CMD ["python", "-m", "capture2vr.edge.worker.health"]
ENTRYPOINT ["capture2vr"]
CMD ["edge"]
