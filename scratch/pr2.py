import sys
exec(open('pr.py').read().split("fine=refined")[0])
lc.MOST_CELLS=int(sys.argv[3]); n=[0]; t0=time.time()
o=lc._cell_slack
def cs(f,stg,one_,two,rate):
    r=o(f,stg,one_,two,rate); n[0]+=1
    if two.v-one_.v<0.003 or n[0]%300==0: print(n[0],one_.v,two.v-one_.v,r,f'{time.time()-t0:.0f}',flush=True)
    return r
lc._cell_slack=cs
r=float(sys.argv[2]); t=time.process_time(); p=lc.prove(one,st,r); print('prove',r,p,'tests',n,'cpu',time.process_time()-t,flush=True)
