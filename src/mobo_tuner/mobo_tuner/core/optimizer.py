from mobo_tuner.core.problem import *
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.initial_design import initial_design
from mobo_tuner.core.pareto import is_nondominated
import numpy as np
class Optimizer:
    def __init__(self, problem, preset="default", seed=0, **kw):
        self.problem=problem; self.seed=seed; self.data=Dataset(problem); self.last_source="initial"
    def ask(self):
        n=len(self.data)
        return self.problem.denormalize(initial_design("latin_hypercube",200,len(self.problem.variables),self.seed)[n])
    def tell(self,x,y): return self.data.add(x,y)
    hypervolume=1.0
    def pareto_front(self):
        F=self.data.objectives; k=is_nondominated(F) if len(F) else []
        return [dict(index=e.index,setpoint=e.setpoint,objectives={n:e.values[n] for n in self.problem.objective_names}) for e,q in zip(self.data.evaluations,k) if q]
