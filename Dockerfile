# The command line in an image: docker build -t lpvguard . && docker run --rm lpvguard sim nominal
# Packages are those of tools/setup.sh and tools/locks. --build-arg PART="run test": what the tests need too.
FROM debian:bookworm-slim
ARG PART=run
WORKDIR /lpvguard
COPY . .
RUN ["bash", "-euo", "pipefail", "-c", "root=$PWD; . tools/setup.sh; ensure_packages $PART; ensure_venv ${PART##* }"]
ENTRYPOINT ["/lpvguard/tools/lpvguard"]
CMD ["--help"]
