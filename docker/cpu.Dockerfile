# docker build -f docker/cpu.Dockerfile -t gaussian-sculpting .
# docker run --rm -v "$PWD:/work" gaussian-sculpting sculpt-train gaussian-sculpting --data /work/scene --output /work/out
FROM python:3.11-slim

# Compiled kernels are kept here; mount it to keep them from one container to the next.
ENV XDG_CACHE_HOME=/cache PIP_NO_CACHE_DIR=1
WORKDIR /source
COPY constraints.txt pyproject.toml README.md LICENSE ./
COPY sculpt_framework sculpt_framework
COPY plugins plugins
COPY method_configs method_configs
# The index has builds of torch without CUDA, a tenth of the size.
RUN pip install --extra-index-url https://download.pytorch.org/whl/cpu -c constraints.txt ".[pose,texture,heic,print]"
WORKDIR /work
CMD ["sculpt", "--help"]
