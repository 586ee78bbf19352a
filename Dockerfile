# docker build -t gcd_dataset .   # without a GPU: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cpu
FROM python:3.12-slim
ARG TORCH_INDEX=https://pypi.org/simple
WORKDIR /opt/gcd_dataset
COPY pyproject.toml constraints.txt README.md LICENSE NOTICE ./
COPY gcd_dataset gcd_dataset
COPY generator generator
COPY loaders loaders
RUN pip install --no-cache-dir -c constraints.txt --index-url "$TORCH_INDEX" torch
RUN pip install --no-cache-dir -c constraints.txt '.[export,ray,s3]'
# The NVIDIA runtime mounts drivers only where this variable asks for them.
ENV NVIDIA_DRIVER_CAPABILITIES=compute,utility
WORKDIR /data
ENTRYPOINT ["gcd"]
