"""What requests and answers look like, over HTTP and in the JSON of the command line: every field with its unit."""
