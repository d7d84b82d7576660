# A stimulator, or any other command of smarttac, for the tests of other software:
#   docker build --tag smarttac .
#   docker run --rm --network host smarttac            # the node below
#   docker run --rm --network host smarttac scan --interface socketcan --channel vcan0
FROM python:3.12-slim
WORKDIR /opt/smarttac
COPY pyproject.toml README.md LICENSE ./
COPY eds eds
COPY smarttac_can smarttac_can
RUN pip install --no-cache-dir ".[multicast,dbc]"
USER nobody
ENTRYPOINT ["smarttac"]
CMD ["node", "--interface", "udp_multicast", "--channel", "239.74.163.2", "--lockstep"]
