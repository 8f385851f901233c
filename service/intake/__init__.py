"""Files that were sent are read here, in processes that can be killed: a hostile file harms no other request."""
