from base import *
from lpvguard.engine.synthesis import knot_search as ks
A_t,A_u=float(sys.argv[1]),float(sys.argv[2])
sch,sc,worst,full=K(100.0,1e-6)
s=with_settings(STORED,A_t=A_t,A_u=A_u)
d=cached(f'Dq_{A_t}_{A_u}',lambda: ms.tuning(sch,partial(frozen_plant,s),sc)(1.0))
fam=ms.scaled_families(s,sch,d)['performance']
t0=time.process_time(); w0=time.time()
nsold=ks.newton_step
def ns(b,P,y,directions,slope,price):
    r=nsold(b,P,y,directions,slope,price)
    print('  ',P.shape[0],len(b.M),'y',np.round(r[1],4),f'dec {r[2]:.3g} w {slope[:1]/max(1,len(b.M)*b.constant.shape[-1])} cost {price@np.concatenate([Q[b.upper] for Q in r[0]]):.3g} cpu {time.process_time()-t0:.0f} wall {time.time()-w0:.0f}',flush=True); return r
ks.newton_step=ns
fo=ll.found_at
def fa(grid,point,rate,unit):
    r=fo(grid,point,rate,unit)
    if r is not None: pickle.dump((rate,grid.basis,grid.knots,r,d),open(f'q_{A_t}_{A_u}_state.pkl','wb'))
    return r
ll.found_at=fa
f=ll._at_level(fam,(2,2),1.0,1.0,lambda x:print(x,f'{time.process_time()-t0:.0f}',flush=True))
print(f and (f.proof,f.gain,f.rate))
pickle.dump((d,f),open(f'q_{A_t}_{A_u}.pkl','wb'))
