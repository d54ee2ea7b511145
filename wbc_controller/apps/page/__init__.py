"""The live page: a robot in the browser, with what its controller thinks, and handles to command it by topics."""
