"""The table of episodes of random actions, which `bojax run` writes beside the results of a learner."""

from bojax.results.schema import Column, Table

FILE = "baseline.parquet"

COLUMNS: Table = (
    Column("action_repeat", "int32", doc="number of steps for which every action is repeated"),
    Column("run", "int32", doc="index of the run; it begins its episodes where the learner's run does"),
    Column("episode", "int32", doc="number of the episode, from 1"),
    Column("return", "float64", doc="sum of the rewards"),
    Column("length", "int32", doc="steps"),
    Column("success", "bool", doc="the goal was reached"),
)
