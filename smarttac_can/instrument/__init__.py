"""The instrument: plate node and stimulator node with the loop between them, and its replay."""
