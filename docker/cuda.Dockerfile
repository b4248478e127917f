# docker build -f docker/cuda.Dockerfile -t gaussian-sculpting:cuda .
# docker run --rm --gpus all -v "$PWD:/work" gaussian-sculpting:cuda sculpt-train gaussian-sculpting --data /work/scene --output /work/out
FROM python:3.11-slim

# PyPI's torch brings CUDA's libraries with it; the driver is the host's. Triton compiles a small launcher with gcc.
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
ENV XDG_CACHE_HOME=/cache PIP_NO_CACHE_DIR=1 NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
WORKDIR /source
COPY constraints.txt pyproject.toml README.md LICENSE ./
COPY sculpt_framework sculpt_framework
COPY plugins plugins
COPY method_configs method_configs
# Any torch from 2.6 on that fits the driver will do: its own version and its libraries' are not pinned.
RUN grep -v -i -E '^(torch|triton|nvidia)' constraints.txt > /tmp/constraints.txt \
    && pip install -c /tmp/constraints.txt ".[pose,texture,heic,print]"
WORKDIR /work
CMD ["sculpt", "--help"]
