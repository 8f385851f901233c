"""Which way, and is there enough energy?"""
